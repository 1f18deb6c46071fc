//! `crazyflie world found`: a shared world on a server, for pilots that join it.

use std::io::Write;

use crazyflie_server::client::{Client, Error};
use crazyflie_server::protocol::{Request, Response, WorldInfo, WorldRequest};
use crazyflie_server::worlds::WorldPlan;

use super::{Failure, Outcome, write_json};

/// Create a shared world on a server, for pilots that join it.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    place: PlaceArgs,
    /// A task of several drones, see crazyflie tasks
    #[arg(long, value_name = "MISSION")]
    mission: String,
    #[command(flatten)]
    plan: PlanArgs,
    /// Word that pilots need to join
    #[arg(long, value_name = "WORD")]
    invitation: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// A world on a server.
#[derive(Debug, clap::Args)]
pub(super) struct PlaceArgs {
    /// ws://HOST:PORT or wss://HOST:PORT
    #[arg(long, default_value = "ws://127.0.0.1:8765", value_name = "URL")]
    pub server: String,
    /// The world's name
    #[arg(long, value_name = "NAME")]
    pub world: String,
}

/// The plan of a world that is founded.
#[derive(Debug, clap::Args)]
pub(super) struct PlanArgs {
    /// Options of a new world's mission, as JSON
    #[arg(long, default_value = "{}", value_name = "JSON", requires = "mission")]
    options: String,
    /// Number of pilots that must join before the first tick
    #[arg(long, default_value_t = 1, value_name = "N", requires = "mission")]
    pilots: usize,
    /// Seed of a new world
    #[arg(long, default_value_t = 0, value_name = "N", requires = "mission")]
    seed: u64,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let request = world_request(&args.place.world, &args.mission, &args.plan, args.invitation.clone())?;
    let info = found(&mut Client::open(&args.place.server)?, request)?;
    if args.json {
        return write_json(&info, out);
    }
    let WorldInfo { world, mission, drones, pilots, .. } = info;
    writeln!(out, "{world}: {mission} of {drones} drones; its first tick waits for {pilots} pilots.")?;
    writeln!(out, "crazyflie world join --server {} --world {world}", args.place.server)?;
    Ok(())
}

/// Returns the request for a world.
///
/// # Errors
/// [`Failure::Usage`] for options that are no JSON.
pub(super) fn world_request(
    world: &str,
    mission: &str,
    plan: &PlanArgs,
    invitation: Option<String>,
) -> Outcome<WorldRequest> {
    let options =
        serde_json::from_str(&plan.options).map_err(|e| Failure::Usage(format!("--options: {e}")))?;
    let PlanArgs { pilots, seed, .. } = *plan;
    let plan = WorldPlan { options, seed, ..WorldPlan::new(mission) };
    Ok(WorldRequest { pilots, invitation, ..WorldRequest::new(world, plan) })
}

/// Founds a world.
///
/// # Errors
/// [`Error::Refused`], also where there is one of that name.
pub(super) fn found(client: &mut Client, request: WorldRequest) -> Result<WorldInfo, Error> {
    match client.request(&Request::World(Box::new(request)))? {
        Response::World(info) => Ok(info),
        other => Err(client.unexpected_response(&other)),
    }
}
