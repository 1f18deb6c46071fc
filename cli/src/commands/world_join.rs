//! `crazyflie world join`: one drone of a shared world, flown over the network by a controller of the
//! registry.

use std::io::Write;
use std::path::PathBuf;

use crazyflie_control::avoidance::CollisionAvoidance;
use crazyflie_control::{ControllerContext, Mode, MultiController, choose};
use crazyflie_env::observation::{ACTION, Interface, OBSERVATION, SETPOINT};
use serde::Deserialize;
use serde_json::{Value, json};

use super::{Failure, Outcome, files};
use crazyflie_server::client::{Client, Error};
use crazyflie_server::flight::squared_distance;

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
    /// Of the mission that is founded, JSON
    #[arg(long, default_value = "{}", value_name = "JSON", requires = "mission")]
    options: String,
    /// How many must join before the first tick
    #[arg(long, default_value_t = 1, value_name = "N", requires = "mission")]
    pilots: usize,
    /// Of the world that is founded
    #[arg(long, default_value_t = 0, value_name = "N", requires = "mission")]
    seed: u64,
    /// The model that the controller believes in, TOML; the thesis's unless given
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// For machines
    #[arg(long)]
    json: bool,
}

/// Reply to `join`: the drone's slot and its first observation.
#[derive(Deserialize)]
struct SlotInfo {
    drone: usize,
    drones: usize,
    tick_s: f64,
    interface: Interface,
    observation: Vec<f32>,
}

/// Reply to `fly`: the result of one tick.
#[derive(Deserialize)]
struct TickResult {
    tick: u64,
    observation: Vec<f32>,
    terminated: bool,
    flying: bool,
    late: u64,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let (joined, last) = fly(args)?;
    let off_m = squared_distance(&last.observation[..3], &last.observation[SETPOINT.range()]).sqrt();
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

fn fly(args: &Args) -> Outcome<(SlotInfo, TickResult)> {
    let model = files::model(args.model.as_deref())?;
    let spec = choose(&args.controller, Value::Null, &|path| std::fs::read(path))?;
    let mut client = Client::open(&args.server)?;
    if let Some(mission) = &args.mission {
        let options: Value =
            serde_json::from_str(&args.options).map_err(|e| Failure::Usage(format!("--options: {e}")))?;
        let fields = json!({"name": args.world, "mission": mission, "options": options, "pilots": args.pilots, "seed": args.seed});
        match client.request::<Value>("world", fields) {
            Err(Error::Refused { code, .. }) if code == "world_taken" => {}
            reply => drop(reply?),
        }
    }
    let joined: SlotInfo = client.request("join", json!({"name": args.world, "drone": args.drone}))?;
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
        pilot.act(&observation, &mut action)?;
        let tick_result: TickResult = client.request("fly", json!({"action": action.map(f64::from)}))?;
        if tick_result.observation.len() < OBSERVATION {
            return Err(client
                .unexpected(format!("an observation of {} numbers", tick_result.observation.len()))
                .into());
        }
        if !tick_result.flying {
            return Ok((joined, tick_result));
        }
        observation.clone_from(&tick_result.observation);
    }
}
