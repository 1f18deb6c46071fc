//! `crazyflie cf2`: simulated Crazyflies that stock cflib scripts fly.

mod beside;
mod page;
mod poses;
mod tables;

use std::io::Write;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::time::Duration;

use crazyflie_crtp::{LinkQuality, Pace, PositionSource, Server, Settings, Watcher};
use crazyflie_env::config::EffectTable;
use crazyflie_env::effects::{add_downwash, check_effects};
use crazyflie_env::error::find_named;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_server::flight::lab_rig;
use serde_json::json;
use tokio_util::sync::CancellationToken;

use super::files::ModelArg;
use super::fly::add_effects;
use super::serve::{start_log, stop_signal};
use super::{Failure, Outcome, files};

pub(super) use beside::Beside;

/// Simulate Crazyflies that stock cflib scripts fly: radio protocol over UDP and TCP
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Number of drones, a metre apart on the ground; they share the air
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=100), value_name = "N")]
    drones: u16,
    #[command(flatten)]
    model: ModelArg,
    /// Vertical form of the model that takes a PWM: thrust, pwm or motors [default: thrust, if the model has it]
    #[arg(long, value_parser = files::vertical, value_name = "FORM")]
    vertical: Option<VerticalInput>,
    /// An effect as NAME=VALUE or NAME.PARAMETER=VALUE, or several as JSON; may be repeated (see `crazyflie
    /// effects`)
    #[arg(long, value_name = "EFFECT")]
    effects: Vec<String>,
    /// Source of the onboard filter's positions: lighthouse (it sees them itself), mocap or aruco (they are sent to it, with a camera's
    /// delay and noise), none (the script has to send them)
    #[arg(long, default_value = "lighthouse", value_parser = position_source, value_name = "NAME")]
    position: PositionSource,
    /// Attached decks, with their parameters and log variables: bcFlow2, bcZRanger2, bcMultiranger, ...
    #[arg(long, value_delimiter = ',', value_parser = deck, value_name = "NAMES")]
    deck: Vec<&'static str>,
    /// Put all drones back on their places, upright and unlocked, when the first script connects; the parameter
    /// sim.reset does so at any time
    #[arg(long)]
    reset: bool,
    /// Simulated seconds per second
    #[arg(long, default_value_t = 1.0, value_parser = |text: &str| files::number(text, 0.05, 20.0), value_name = "F")]
    speed: f64,
    /// Let clients drive the clock instead: flights do not depend on the speed of the machine, and the same commands
    /// fly the same bits. Set-points and logs have their latency in simulated time then
    #[arg(long, conflicts_with = "speed")]
    lockstep: bool,
    /// Share of set-points, positions and logs that are lost; a radio repeats the rest until it gets through
    #[arg(long, default_value_t = 0.0, value_parser = |text: &str| files::number(text, 0.0, 0.95), value_name = "P")]
    loss: f64,
    /// Seconds that a packet takes from one end to the other
    #[arg(long, default_value_t = 0.0, value_parser = |text: &str| files::seconds(text, 0.0, 1.0), value_name = "S")]
    latency: f64,
    /// Seed of noise, losses and drawn parameters
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Drones wait for an arming request, as a Crazyflie Brushless does
    #[arg(long)]
    no_auto_arm: bool,
    /// Address to listen on. The protocol knows no authentication: beyond this machine anybody can fly
    #[arg(long, default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST), value_name = "ADDRESS")]
    host: IpAddr,
    /// UDP port of the first drone, the others follow; 0 for any. cflib's scan looks at 19850 to 19859
    #[arg(long, default_value_t = 19850, value_name = "PORT")]
    port: u16,
    /// Listen on TCP, too, as an AI deck does (CPX), from this port on
    #[arg(long, num_args = 0..=1, default_missing_value = "5050", value_name = "PORT")]
    tcp: Option<u16>,
    /// Show the drones on the page of a server, which listens here; port 0 for any
    #[arg(long, num_args = 0..=1, default_missing_value = "127.0.0.1:8765", value_name = "ADDRESS:PORT")]
    page: Option<SocketAddr>,
    /// Send the true poses there, as the bridge of a motion capture would: JSON in datagrams, as `crazyflie deploy
    /// --position mocap` takes them; drones are the bodies 0, 1, ... With a file they are its lines. May be repeated
    #[arg(long, value_parser = poses::listener, value_name = "ADDRESS:PORT|FILE")]
    poses: Vec<poses::Listener>,
    /// Print the drones' addresses as JSON
    #[arg(long)]
    json: bool,
    /// Level of the log: error, warn, info, debug or trace
    #[arg(long, default_value = "warn", value_name = "LEVEL")]
    log: String,
    /// List parameters and log variables instead
    #[arg(long)]
    tables: bool,
    /// With --tables: as a page of the documentation
    #[arg(long, requires = "tables")]
    markdown: bool,
}

fn deck(name: &str) -> Result<&'static str, String> {
    crazyflie_crtp::deck(name).map_err(|e| e.to_string())
}

fn position_source(name: &str) -> Result<PositionSource, String> {
    let all = [
        ("lighthouse", PositionSource::Lighthouse),
        ("mocap", PositionSource::Mocap),
        ("aruco", PositionSource::Aruco),
        ("none", PositionSource::Script),
    ];
    let entry = find_named("position source", name, all, |(known, _)| known);
    entry.map(|(_, source)| source).map_err(|error| error.to_string())
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    if args.tables {
        return tables::write(args.json, args.markdown, out);
    }
    let settings = settings(args)?;
    start_log(&args.log, false)?;
    if !args.host.is_loopback() {
        tracing::warn!("--host {}: CRTP knows no authentication, anybody who reaches it can fly", args.host);
    }
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    runtime.block_on(async {
        let (watcher, page) = match args.page {
            Some(address) => {
                let (watcher, page) = page::Page::bind(address, &settings).await?;
                (Some(watcher), Some(page))
            }
            None => (None, None),
        };
        let poses = args.poses.iter().map(poses::watcher);
        let watchers = watcher.into_iter().map(Ok).chain(poses).collect::<Outcome<Vec<_>>>()?;
        let server =
            Server::bind(&settings, all(watchers)).await.map_err(|e| Failure::Failed(e.to_string()))?;
        announce(&server, page.as_ref(), args.json, out)?;
        let stop = CancellationToken::new();
        let (stopped, signal) = (stop.clone(), stop_signal()?);
        tokio::spawn(async move {
            signal.await;
            stopped.cancel();
        });
        let shown = page.map(|page| tokio::spawn(page.run(stop.clone())));
        server.run(stop).await;
        match shown {
            Some(shown) => shown.await.map_err(|e| Failure::Failed(e.to_string()))?,
            None => Ok(()),
        }
    })
}

/// Returns one watcher that notifies several.
fn all(mut watchers: Vec<Watcher>) -> Option<Watcher> {
    if watchers.is_empty() {
        return None;
    }
    Some(Box::new(move |moments| watchers.iter_mut().for_each(|watcher| watcher(moments))))
}

/// For people, and for programs that start this and must know where it is.
fn announce(server: &Server, page: Option<&page::Page>, json: bool, out: &mut dyn Write) -> Outcome {
    let drones = server.addresses().iter().map(|address| {
        let tcp = address.tcp.map(|tcp| format!("tcp://{tcp}"));
        (format!("udp://{}", address.udp), tcp)
    });
    let page = page.map(|page| format!("http://{}", page.address));
    if json {
        let drones: Vec<_> = drones.map(|(udp, tcp)| json!({"udp": udp, "tcp": tcp})).collect();
        writeln!(out, "{}", json!({"drones": drones, "page": page}))?;
    } else {
        for (udp, tcp) in drones {
            writeln!(out, "{udp}{}", tcp.map(|tcp| format!(" {tcp}")).unwrap_or_default())?;
        }
        page.map_or(Ok(()), |page| writeln!(out, "{page}"))?;
    }
    Ok(out.flush()?)
}

fn settings(args: &Args) -> Outcome<Settings> {
    let model = args.model.read()?;
    let vertical = vertical(&model, args.vertical)?;
    let mut effects = EffectTable::new();
    if args.position == PositionSource::Aruco {
        effects.extend(lab_rig());
    }
    args.effects.iter().try_for_each(|text| add_effects(&mut effects, text))?;
    if args.drones > 1 {
        add_downwash(&mut effects);
    }
    check_effects(&effects)?;
    check_ports(args.port, args.drones)?;
    Ok(Settings {
        model,
        vertical,
        effects,
        drones: args.drones.into(),
        pace: if args.lockstep { Pace::Lockstep } else { Pace::Clock { speed: args.speed } },
        quality: LinkQuality { loss: args.loss, latency: Duration::from_secs_f64(args.latency) },
        seed: args.seed,
        positions: args.position,
        auto_arms: !args.no_auto_arm,
        decks: args.deck.clone(),
        resets: args.reset,
        host: args.host,
        port: args.port,
        tcp_port: args.tcp,
    })
}

fn check_ports(first: u16, drones: u16) -> Outcome {
    let last = usize::from(first) + usize::from(drones) - 1;
    if first != 0 && last > usize::from(u16::MAX) {
        return Err(Failure::Usage(format!("--port {first}: the last drone's would be {last}")));
    }
    Ok(())
}

/// Scripts command a thrust, and a motor that is off must let the vehicle fall: the form `thrust` before others.
fn vertical(model: &Model, asked: Option<VerticalInput>) -> Outcome<VerticalInput> {
    let inputs = model.inputs();
    if let Some(asked) = asked {
        if !asked.is_pwm() {
            return Err(Failure::Usage(format!(
                "--vertical {}: set-points of cflib are thrusts, expected thrust, pwm or motors",
                asked.name()
            )));
        }
        return Ok(model.input(Some(asked))?);
    }
    let input = [VerticalInput::Thrust, VerticalInput::Motors, VerticalInput::Pwm]
        .into_iter()
        .find(|input| inputs.contains(input));
    input.ok_or_else(|| {
        Failure::Usage(format!("{} has no vertical form that takes a PWM: thrust, pwm or motors", model.name))
    })
}
