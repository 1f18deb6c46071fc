//! `crazyflie world join`: one drone of a shared world, flown over the network by a controller of the
//! registry.

use std::io::Write;
use std::time::{Duration, Instant};

use crazyflie_control::avoidance::CollisionAvoidance;
use crazyflie_control::{ControllerContext, Mode, MultiController, choose};
use crazyflie_env::action::ACTION;
use crazyflie_env::observation::{OBSERVATION, SETPOINT};
use crazyflie_server::client::{Client, Error};
use crazyflie_server::flight::squared_distance;
use crazyflie_server::protocol::{
    Code, Fly, Join, Numbers, Request, Response, SlotInfo, TickResult, WorldRequest,
};
use serde_json::{Value, json};

use super::files::ModelArg;
use super::world_found::{PlaceArgs, PlanArgs, found, world_request};
use super::{Failure, Outcome};

/// Pause between two tries to join.
const RETRY: Duration = Duration::from_millis(200);

/// Fly one drone of a shared world of a server.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    place: PlaceArgs,
    /// Number of the drone [default: the first free one]
    #[arg(long, value_name = "N")]
    drone: Option<usize>,
    /// NAME or NAME:FILE, see crazyflie controllers
    #[arg(long, default_value = "thesis-pid", value_name = "NAME")]
    controller: String,
    /// Keep out of the others' way
    #[arg(long)]
    collision_avoidance: bool,
    /// Create the world with this mission if it does not exist
    #[arg(long, value_name = "MISSION")]
    mission: Option<String>,
    #[command(flatten)]
    plan: PlanArgs,
    /// Time to wait for the server and the world
    #[arg(long, default_value_t = 0.0, value_name = "SECONDS")]
    wait: f64,
    #[command(flatten)]
    model: ModelArg,
    /// Word that pilots need to join; a world that is created requires it from then on
    #[arg(long, value_name = "WORD")]
    invitation: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let (joined, last) = fly(args)?;
    let off_m = squared_distance(&last.observation.0[..3], &last.observation.0[SETPOINT.range()]).sqrt();
    let outcome = if last.terminated { "its flight ended" } else { "the time was over" };
    let (drone, world, TickResult { tick, late, .. }) = (joined.drone, &args.place.world, &last);
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
    let (mut client, joined) = join_in_time(args)?;
    let (interface, tick_s) = (joined.interface, joined.tick_s);
    let site = ControllerContext { model: &model, interface, tick_s, envs: 1, mode: Mode::Automatic };
    let avoid = args.collision_avoidance.then(CollisionAvoidance::default);
    let mut pilot = MultiController::among(vec![spec.build(&site)?], joined.drones - 1, 1, avoid, tick_s)?;
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

/// Joins, and tries again until the time to wait is over.
fn join_in_time(args: &Args) -> Outcome<(Client, SlotInfo<'static>)> {
    let request =
        |mission: &String| world_request(&args.place.world, mission, &args.plan, args.invitation.clone());
    let request = args.mission.as_ref().map(request).transpose()?;
    let wait = Duration::try_from_secs_f64(args.wait)
        .map_err(|_| Failure::Usage(format!("--wait is {}, expected seconds from 0 on", args.wait)))?;
    let begin = Instant::now();
    loop {
        let problem = match join(args, request.clone()) {
            Ok(joined) => return Ok(joined),
            Err(problem) => problem,
        };
        let may_pass = matches!(
            problem,
            Error::Connect { .. } | Error::Refused { code: Code::UnknownWorld | Code::NoFreeDrone, .. }
        );
        if !may_pass || begin.elapsed() >= wait {
            return Err(problem.into());
        }
        std::thread::sleep(RETRY);
    }
}

fn join(args: &Args, request: Option<WorldRequest>) -> Result<(Client, SlotInfo<'static>), Error> {
    let mut client = Client::open(&args.place.server)?;
    if let Some(request) = request {
        match found(&mut client, request) {
            Ok(_) | Err(Error::Refused { code: Code::WorldTaken, .. }) => {}
            Err(error) => return Err(error),
        }
    }
    let (name, invitation) = (args.place.world.clone(), args.invitation.clone());
    match client.request(&Request::Join(Join { name, drone: args.drone, token: None, invitation }))? {
        Response::Joined(slot) => Ok((client, *slot)),
        other => Err(client.unexpected_response(&other)),
    }
}
