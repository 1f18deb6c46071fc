//! `crazyflie world join`: one drone of a shared world, flown over the network by a controller of the
//! registry.

use std::io::Write;

use crazyflie_control::avoidance::CollisionAvoidance;
use crazyflie_control::{ControllerContext, Mode, MultiController, choose};
use crazyflie_env::action::ACTION;
use crazyflie_env::observation::{OBSERVATION, SETPOINT};
use crazyflie_server::client::{Client, Error};
use crazyflie_server::flight::squared_distance;
use crazyflie_server::protocol::{
    Code, Fly, Join, Numbers, Request, Response, SlotInfo, TickResult, WorldRequest,
};
use crazyflie_server::worlds::WorldPlan;
use serde_json::{Value, json};

use super::files::ModelArg;
use super::{Failure, Outcome};

const EXAMPLES: &str = "\
Examples:
  crazyflie world join --world room --mission swap --options '{\"drones\": 2}' --pilots 2 --collision-avoidance
  crazyflie world join --world room --drone 1 --controller lqr
  crazyflie world join --server wss://lab.example --world room --controller kalman+thesis-pid";

/// Fly one drone of a shared world of a server.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// ws://HOST:PORT or wss://HOST:PORT
    #[arg(long, default_value = "ws://127.0.0.1:8765", value_name = "URL")]
    server: String,
    /// The world's name
    #[arg(long, value_name = "NAME")]
    world: String,
    /// Which of its drones; the first that is free unless given
    #[arg(long, value_name = "N")]
    drone: Option<usize>,
    /// NAME or NAME:FILE, see crazyflie controllers
    #[arg(long, default_value = "thesis-pid", value_name = "NAME")]
    controller: String,
    /// Keep out of the others' way
    #[arg(long)]
    collision_avoidance: bool,
    /// Found the world with this mission, if there is none of the name
    #[arg(long, value_name = "MISSION")]
    mission: Option<String>,
    /// Options of the mission that is founded, as JSON
    #[arg(long, default_value = "{}", value_name = "JSON", requires = "mission")]
    options: String,
    /// Number of pilots that must join before the first tick
    #[arg(long, default_value_t = 1, value_name = "N", requires = "mission")]
    pilots: usize,
    /// Seed of the world that is founded
    #[arg(long, default_value_t = 0, value_name = "N", requires = "mission")]
    seed: u64,
    #[command(flatten)]
    model: ModelArg,
    /// The word that joining needs; of a world that is founded, the word that it will need
    #[arg(long, value_name = "WORD")]
    invitation: Option<String>,
    /// For machines
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let (joined, last) = fly(args)?;
    let off_m = squared_distance(&last.observation.0[..3], &last.observation.0[SETPOINT.range()]).sqrt();
    let outcome = if last.terminated { "its flight ended" } else { "the time was over" };
    let (drone, world, TickResult { tick, late, .. }) = (joined.drone, &args.world, &last);
    if args.json {
        let reply = json!({"world": world, "drone": drone, "ticks": tick, "late": late, "terminated": last.terminated, "error_m": off_m});
        return Ok(writeln!(out, "{reply:#}")?);
    }
    writeln!(
        out,
        "drone {drone} of {world}: {tick} ticks, {outcome}; late {late} times; {off_m:.3} m from its set-point by its own measurement"
    )?;
    Ok(())
}

fn fly(args: &Args) -> Outcome<(SlotInfo<'static>, TickResult<'static>)> {
    let model = args.model.read()?;
    let spec = choose(&args.controller, Value::Null, &|path| std::fs::read(path))?;
    let mut client = Client::open(&args.server)?;
    if let Some(mission) = &args.mission {
        create_world(&mut client, args, mission)?;
    }
    let (name, invitation) = (args.world.clone(), args.invitation.clone());
    let join = Join { name, drone: args.drone, token: None, invitation };
    let joined = match client.request(&Request::Join(join))? {
        Response::Joined(slot) => *slot,
        other => return Err(client.unexpected_response(&other).into()),
    };
    let controller = spec.build(&ControllerContext {
        model: &model,
        interface: joined.interface,
        tick_s: joined.tick_s,
        envs: 1,
        mode: Mode::Automatic,
    })?;
    let mut pilot = MultiController::single(
        controller,
        joined.drones - 1,
        1,
        args.collision_avoidance.then(CollisionAvoidance::default),
        joined.tick_s,
    )?;
    let (mut observation, mut action) = (joined.observation.clone(), [0.0; ACTION]);
    loop {
        pilot.act(&observation.0, &mut action)?;
        let fly = Fly { action: Numbers(action.to_vec().into()) };
        let result = match client.request(&Request::Fly(fly))? {
            Response::Flown { result, .. } => result,
            other => return Err(client.unexpected_response(&other).into()),
        };
        let width = result.observation.0.len();
        if width < OBSERVATION {
            return Err(client.unexpected(format!("an observation of {width} numbers")).into());
        }
        if !result.flying {
            return Ok((joined, result));
        }
        observation = result.observation;
    }
}

/// Makes the world, unless there is one of that name.
fn create_world(client: &mut Client, args: &Args, mission: &str) -> Outcome {
    let options =
        serde_json::from_str(&args.options).map_err(|e| Failure::Usage(format!("--options: {e}")))?;
    let plan = WorldPlan { options, seed: args.seed, ..WorldPlan::new(mission) };
    let invitation = args.invitation.clone();
    let request = WorldRequest { pilots: args.pilots, invitation, ..WorldRequest::new(&args.world, plan) };
    match client.request(&Request::World(Box::new(request))) {
        Ok(Response::World(_)) | Err(Error::Refused { code: Code::WorldTaken, .. }) => Ok(()),
        Ok(other) => Err(client.unexpected_response(&other).into()),
        Err(error) => Err(error.into()),
    }
}
