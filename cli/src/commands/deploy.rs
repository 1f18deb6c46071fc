//! `crazyflie deploy`: a controller flies a real Crazyflie, or one of `crazyflie cf2`. The options are
//! checked here; the radio library is in Python, so the Python package flies.

use std::path::PathBuf;
use std::sync::OnceLock;

use crazyflie_env::model::VerticalInput;
use serde::Serialize;
use serde_json::{Value, json};

use super::files::ModelArg;
use super::{Failure, Outcome, controllers, files, fly};

/// Fly a real Crazyflie, or one of `crazyflie cf2`, with any controller: take-off, task, landing, and a log
#[derive(Debug, clap::Args, Serialize)]
pub(super) struct Args {
    /// Address as cflib takes it: radio://..., udp://HOST:PORT or tcp://HOST:PORT; several fly together, in one frame
    #[arg(long, num_args = 1.., required = true, value_name = "URI")]
    uri: Vec<String>,
    /// Controller, as NAME, NAME:FILE or python:FILE:NAME (see `crazyflie controllers`)
    #[arg(long, default_value = "thesis-pid", value_name = "NAME")]
    controller: String,
    /// The controller's options, as JSON
    #[arg(long, value_name = "JSON")]
    controller_options: Option<String>,
    #[command(flatten)]
    #[serde(flatten)]
    model: ModelArg,
    /// Vertical form of the model that is commanded: thrust, pwm or motors (sent as a thrust), or height (sent as
    /// a height over the floor) [default: thrust, if the model has it]
    #[arg(long, value_parser = files::vertical, value_name = "FORM")]
    vertical: Option<VerticalInput>,
    /// A task whose set-points are known beforehand (see `crazyflie tasks`), or a task file; of as many drones as
    /// there are addresses
    #[arg(long, default_value = "hover", value_name = "NAME|FILE")]
    task: String,
    /// The task's options, as JSON
    #[arg(long, value_name = "JSON")]
    task_options: Option<String>,
    /// CSV file with the track of the task `track`: columns t_s, x_m, y_m, z_m and optionally yaw_rad or
    /// yaw_deg
    #[arg(long, value_name = "FILE.csv")]
    #[serde(skip)]
    track: Option<PathBuf>,
    /// Place for the task `hover`, in metres, and the heading in degrees
    #[arg(long, allow_hyphen_values = true, value_name = "X,Y,Z[,YAW]", value_parser = setpoint)]
    #[serde(skip)]
    setpoint: Option<Numbers>,
    /// Time of the controller, between take-off and landing
    #[arg(long = "duration", default_value_t = 10.0, value_parser = |text: &str| files::seconds(text, 0.1, 3600.0), value_name = "S")]
    duration_s: f64,
    /// Height of the take-off, which the vehicle's own commander flies
    #[arg(long = "takeoff-height", default_value_t = 0.5, value_parser = |text: &str| files::number(text, 0.1, 3.0), value_name = "M")]
    takeoff_height_m: f64,
    /// Source of the positions: estimate (the vehicle's own, by Lighthouse or Flow deck), mocap (motion capture),
    /// aruco (a marker seen by the vehicle's camera)
    #[arg(long, default_value = "estimate", value_parser = ["estimate", "mocap", "aruco"], value_name = "NAME")]
    position: String,
    /// Source of the poses of mocap and aruco: udp://HOST:PORT[/BODY], JSON in datagrams, or python:FILE:NAME, a
    /// function that yields them
    #[arg(long, default_value = "udp://127.0.0.1:9870", value_name = "SOURCE")]
    poses: String,
    /// Land when farther from the origin along x or y, or higher
    #[arg(long = "room", default_value = "1.5,1.5,2", value_parser = room, value_name = "X,Y,Z")]
    room_m: Numbers,
    /// Land when tilted farther
    #[arg(long = "tilt-max", default_value_t = 35.0, value_parser = |text: &str| files::number(text, 1.0, 90.0), value_name = "DEG")]
    tilt_max_deg: f64,
    /// Land when the battery is below this for half a second; 0 for no limit
    #[arg(long = "battery-min", default_value_t = 3.1, value_parser = |text: &str| files::number(text, 0.0, 5.0), value_name = "V")]
    battery_min_v: f64,
    /// Level the vehicle when its position is older than this, and land if no new one comes
    #[arg(long = "stale", default_value_t = 0.25, value_parser = |text: &str| files::seconds(text, 0.05, 2.0), value_name = "S")]
    stale_s: f64,
    /// Land when the flight, take-off included, takes longer
    #[arg(long = "time-limit", default_value_t = 240.0, value_parser = |text: &str| files::seconds(text, 1.0, 3600.0), value_name = "S")]
    time_limit_s: f64,
    /// Let several vehicles fly without the layer that keeps them out of each other's way
    #[arg(long = "no-collision-avoidance", action = clap::ArgAction::SetFalse)]
    collision_avoidance: bool,
    /// Drive the clock of a vehicle of `crazyflie cf2 --lockstep`: a tick for each command, as fast as the machine can
    #[arg(long)]
    lockstep: bool,
    /// Write the flight as a log that `replay`, `identify` and `explain` read; its settings go to
    /// FILE.csv.json [default: deploy-DATE-TIME.csv]
    #[arg(long, visible_alias = "csv", value_name = "FILE.csv")]
    log: Option<PathBuf>,
    /// Seed of the values that the task draws
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print JSON; progress goes to standard error
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Serialize)]
struct Numbers(Vec<f64>);

/// Flies by an object of settings, as JSON.
pub type Deployer = fn(&str) -> Result<(), Failure>;

static DEPLOYER: OnceLock<Deployer> = OnceLock::new();

/// Sets the deployer of this process; the first call counts.
pub fn set_deployer(deployer: Deployer) {
    DEPLOYER.get_or_init(|| deployer);
}

pub(super) fn run(args: &Args) -> Outcome {
    let settings = settings(args)?;
    let deploy = DEPLOYER.get().ok_or_else(|| {
        Failure::Failed(
            "deploy: the radio library cflib is in Python, and this program has no Python in it: use the one of the Python package (pip install \"crazyflie-gym[cflib]\")".into(),
        )
    })?;
    deploy(&settings.to_string())
}

/// Options for the Python package, by the names of its own keywords.
fn settings(args: &Args) -> Outcome<Value> {
    // mistakes are told before anything is connected
    controllers::chosen(&args.controller, args.controller_options.as_deref())?;
    let model = args.model.read()?;
    let vertical = match args.vertical {
        Some(asked) => model.input(Some(asked))?,
        // a thrust, as real vehicles and those of `cf2` take it
        None => {
            files::first_vertical(&model, &[VerticalInput::Thrust, VerticalInput::Motors, VerticalInput::Pwm])
        }
    };
    let own = fly::own_task(&args.task)?;
    let task = own.as_ref().map_or(&args.task, |own| &own.options.task);
    let of_file = own.as_ref().map(|own| &own.options.task_options);
    let (given, track) = (args.task_options.as_deref(), args.track.as_deref());
    let mut task_options = fly::task_options(task, of_file, given, track)?.unwrap_or_else(|| json!({}));
    if let Some(Numbers(numbers)) = &args.setpoint {
        Failure::unless(task == "hover", || format!("--setpoint is for the task hover, --task is {task}"))?;
        task_options["setpoint_m"] = json!(numbers[..3]);
        task_options["setpoint_yaw_deg"] = json!(numbers.get(3).copied().unwrap_or(0.0));
    }
    let options = args.controller_options.as_deref();
    let mut settings = serde_json::to_value(args)?;
    settings["controller_options"] = json!(options.and_then(|text| serde_json::from_str::<Value>(text).ok()));
    if let [uri] = &args.uri[..] {
        settings["uri"] = json!(uri);
    }
    settings["vertical"] = json!(vertical.name());
    settings["task"] = json!(task);
    settings["task_options"] = task_options;
    Ok(settings)
}

fn numbers(text: &str) -> Option<Vec<f64>> {
    let numbers =
        text.split(',').map(|part| part.trim().parse().ok().filter(|number: &f64| number.is_finite()));
    numbers.collect()
}

fn setpoint(text: &str) -> Result<Numbers, String> {
    let values = numbers(text).filter(|values| (3..=4).contains(&values.len()));
    values
        .map(Numbers)
        .ok_or_else(|| "expected x, y and z in metres, and the heading in degrees if wanted".into())
}

fn room(text: &str) -> Result<Numbers, String> {
    let sizes = numbers(text).filter(|sizes| sizes.len() == 3 && sizes.iter().all(|size| *size > 0.0));
    sizes.map(Numbers).ok_or_else(|| "expected three distances in metres, above 0".into())
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    fn asked(words: &[&str]) -> Outcome<Value> {
        let all = ["deploy", "--uri", "udp://127.0.0.1:1"].iter().chain(words);
        settings(&Line::try_parse_from(all).unwrap().args)
    }

    #[test]
    fn what_is_asked_for_is_told_in_the_words_of_the_package() {
        let told =
            asked(&["--setpoint", "-0.5,0.25,0.7,90", "--vertical", "height", "--room", "1,2,3"]).unwrap();
        assert_eq!(told["task_options"], json!({"setpoint_m": [-0.5, 0.25, 0.7], "setpoint_yaw_deg": 90.0}));
        assert_eq!((&told["vertical"], &told["room_m"]), (&json!("height"), &json!([1.0, 2.0, 3.0])));
        assert_eq!(asked(&[]).unwrap()["vertical"], "thrust");
    }

    #[test]
    fn mistakes_are_told_before_anything_is_connected() {
        for (words, told) in [
            (&["--controller", "lqt"][..], "did you mean \"lqr\""),
            (&["--task", "track", "--setpoint", "0,0,1"], "for the task hover"),
            (&["--model", "gone.toml"], "gone.toml"),
            (&["--track", "way.csv"], "for the task track"),
        ] {
            let error = asked(words).unwrap_err().to_string();
            assert!(error.contains(told), "{words:?}: {error}");
        }
        let all = ["deploy", "--uri", "x", "--room", "1,0,2"];
        assert!(Line::try_parse_from(all).unwrap_err().to_string().contains("above 0"));
    }

    #[test]
    fn without_python_the_error_says_what_to_install() {
        let line = Line::try_parse_from(["deploy", "--uri", "udp://127.0.0.1:1"]).unwrap();
        let error = run(&line.args).unwrap_err().to_string();
        assert!(error.contains("pip install \"crazyflie-gym[cflib]\""), "{error}");
    }
}
