//! A trained policy from a file (safetensors): a network, the normalisation of its inputs, and what it reads.
//!
//! A file of the format `crazyflie-policy-3` reads any observation ([`row`]); `crazyflie_gym.export_policy` writes it. One
//! of `crazyflie-policy-2` reads features of an estimate by the Kalman filter, with moving averages of some signals, and
//! adds a linear function of them; `crazyflie_gym.ppo` writes it, and does the same in Python.

mod export_c;
mod network;
mod row;

use std::sync::Arc;

use safetensors::SafeTensors;
use serde::{Deserialize, Serialize};

use super::landing::Landing;
use super::{Batch, ControlLaw, Controller, ControllerConfig, ControllerContext, Entry, Mode, defaults};
use crazyflie_env::action::{ACTION, ActionLevel, Interface};
use crazyflie_env::error::Result;
use crazyflie_env::estimator::{Estimate, Estimator, SensorNoise};
use crazyflie_env::model::VerticalInput;
use crazyflie_env::observation::{OBSERVATION, index};
use crazyflie_env::plant::Command;
use crazyflie_env::scalar::{Scalar, tabulate, wrap};
use network::{Activation, LayerKind, MOST_LAYERS, Network, Scratch, deviations, layers, tensor, vector};

/// There are none: all is in the file.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Options {}

pub(super) const ENTRY: Entry = Entry {
    name: "policy",
    also: None,
    about: "A policy trained by reinforcement learning (`crazyflie_gym.export_policy`, `python -m crazyflie_gym.ppo`), flown \
            without Python",
    source: "Proximal policy optimisation (Schulman et al. 2017) with an asymmetric critic (Pinto et al. 2018)",
    any_level: true,
    file: Some("network, normalisation and observation of a policy, as safetensors"),
    member: None,
    options: &[],
    defaults: defaults::<Options>,
    build: |given, site| {
        let Options {} = given.options()?;
        match PolicyFile::read(given)?.contents(given, site)? {
            Contents::Row(policy) => policy.controller(given, site),
            Contents::Features(policy) => {
                let law = Policy::new(policy, site);
                Ok(Box::new(Batch::new(site.envs, law)) as Box<dyn Controller>)
            }
        }
    },
};

pub use export_c::{PolicyCode, export_c};

/// The format that reads any observation, and the one that reads features.
const FORMATS: [&str; 2] = ["crazyflie-policy-3", "crazyflie-policy-2"];
/// Signals with moving averages: position error (3), roll, pitch, last action from level (4), set-point (3).
const SIGNALS: usize = 12;
/// Number of present features: position error (3), velocity (3), push (3), yaw error, roll, pitch, gyro (3), last
/// action from level (4).
const PRESENT: usize = 19;
/// Normalised features beyond so many standard deviations are cut off.
const CLIP: f64 = 5.0;
/// More than these is another kind of file.
const MOST_AVERAGES: usize = 8;

/// Returns the action level and the vertical form that the file of a policy names.
pub(super) fn trained_for(bytes: &[u8]) -> Option<(ActionLevel, VerticalInput)> {
    let (_, header) = SafeTensors::read_metadata(bytes).ok()?;
    let about = header.metadata().as_ref()?;
    Some((ActionLevel::named(about.get("action")?).ok()?, VerticalInput::named(about.get("vertical")?).ok()?))
}

/// A file that has been recognised.
struct PolicyFile<'a> {
    bytes: &'a [u8],
    about: std::collections::HashMap<String, String>,
}

/// Contents of the file, by format.
enum Contents {
    Row(row::RowPolicy),
    Features(FeaturePolicy),
}

impl<'a> PolicyFile<'a> {
    /// # Errors
    /// [`crazyflie_env::Error::Config`] for another kind of file.
    fn read(given: &ControllerConfig<'a>) -> Result<Self> {
        let bytes = given.file.unwrap_or_default();
        let bad = |what: String| given.problem(format!("the file of the policy: {what}"));
        let (_, header) =
            SafeTensors::read_metadata(bytes).map_err(|e| bad(format!("no safetensors ({e})")))?;
        let file = PolicyFile { bytes, about: header.metadata().clone().unwrap_or_default() };
        let format = file.get("format").unwrap_or("not said");
        if FORMATS.contains(&format) {
            return Ok(file);
        }
        let anew = ": train it anew, version 0.2 reads other features";
        let hint = if format == "crazyflie-policy-1" { anew } else { "" };
        let known = FORMATS.map(|name| format!("{name:?}")).join(" or ");
        Err(bad(format!("its format is {format:?}, expected {known}{hint}")))
    }

    fn get(&self, key: &str) -> Option<&str> {
        self.about.get(key).map(String::as_str)
    }

    /// # Errors
    /// [`crazyflie_env::Error::Config`] naming the tensor that is missing, has another shape or type or contains a
    /// value that is not a number; or that the policy was trained for another tick or other commands.
    fn contents(&self, given: &ControllerConfig<'_>, site: &ControllerContext<'_>) -> Result<Contents> {
        let bad = |what: String| given.problem(format!("the file of the policy: {what}"));
        let tick_s: f64 = self.get("tick_s").and_then(|text| text.parse().ok()).unwrap_or(f64::NAN);
        // half a microsecond for the rounding of a decimal
        if tick_s.is_nan() || (tick_s - site.tick_s).abs() > 5e-7 {
            return Err(bad(format!("it was trained for ticks of {tick_s} s, expected {} s", site.tick_s)));
        }
        let tensors = SafeTensors::deserialize(self.bytes).map_err(|e| bad(e.to_string()))?;
        if self.get("format") == Some(FORMATS[0]) {
            let policy = row::RowPolicy::read(self, &tensors).map_err(bad)?;
            policy.check_commands(&site.interface).map_err(|what| given.problem(what))?;
            return Ok(Contents::Row(policy));
        }
        if !site.interface.input.is_pwm() {
            return Err(given.problem(
                "it commands a thrust, and a height is asked for: expected the vertical form pwm or thrust",
            ));
        }
        FeaturePolicy::read(&tensors, tick_s).map(Contents::Features).map_err(bad)
    }
}

/// A network over features of an estimate.
#[derive(Debug)]
struct FeaturePolicy {
    network: Network,
    /// Gains of the moving averages, per tick.
    gains: Vec<f64>,
}

impl FeaturePolicy {
    fn read(tensors: &SafeTensors<'_>, tick_s: f64) -> std::result::Result<Self, String> {
        let (taus, _) = tensor(tensors, "taus_s", 1)?;
        if !(1..=MOST_AVERAGES).contains(&taus.len()) || taus.iter().any(|tau| *tau < 0.0) {
            return Err(format!("taus_s is {taus:?}, expected 1 to {MOST_AVERAGES} positive times"));
        }
        let width = PRESENT + SIGNALS * taus.len();
        let (mean, std) =
            (vector(tensors, "feature_mean", width)?, deviations(tensors, "feature_std", width)?);
        let names = tensors.names();
        let count =
            (0..=MOST_LAYERS).take_while(|n| names.iter().any(|name| **name == format!("layer{n}.weight")));
        let mut kinds = vec![LayerKind::Dense { activation: Activation::Tanh }; count.count()];
        if let Some(last) = kinds.last_mut() {
            *last = LayerKind::Dense { activation: Activation::Identity };
        }
        let layers = layers(tensors, &kinds, width)?;
        let (skip, shape) = tensor(tensors, "skip.weight", 2)?;
        if shape != [width, ACTION] {
            return Err(format!("skip.weight has the shape {shape:?}, expected {:?}", [width, ACTION]));
        }
        let gains = taus.iter().map(|tau| tick_s / (f64::from(*tau) + tick_s)).collect();
        Ok(FeaturePolicy { network: Network { mean, std, clip: CLIP, layers, skip }, gains })
    }
}

/// The policy of one drone, or of lanes.
#[derive(Debug, Clone)]
struct Policy<R: Scalar> {
    policy: Arc<FeaturePolicy>,
    estimator: Estimator<R>,
    interface: Interface,
    landing: Landing<R>,
    /// Moving averages, [`SIGNALS`] for each time constant.
    averages: Vec<R>,
    scratch: Scratch<R>,
    fresh: R::Mask,
}

impl<R: Scalar> Policy<R> {
    fn new(policy: FeaturePolicy, site: &ControllerContext<'_>) -> Self {
        Policy {
            averages: vec![R::zero(); SIGNALS * policy.gains.len()],
            scratch: Scratch::new(&policy.network),
            estimator: Estimator::new(site.model, site.interface.input, site.tick_s, &SensorNoise::default()),
            policy: Arc::new(policy),
            interface: site.interface,
            landing: Landing::new(site.mode, site.tick_s),
            fresh: !R::nothing(),
        }
    }

    /// The features of a row go into the first layer.
    #[inline(always)]
    fn read_signals(&mut self, o: &[R; OBSERVATION], e: &Estimate<R>, height: R, rest: &[R; ACTION]) {
        let (fresh, x) = (self.fresh, &mut self.scratch.layer[0]);
        let (sin, cos) = e.yaw_rad.sin_cos();
        let [px, py, pz] = e.pos_m;
        let error = [o[index::SETPOINT_X] - px, o[index::SETPOINT_Y] - py, height - pz];
        let off: [R; ACTION] = tabulate(
            #[inline(always)]
            |i| o[index::LAST_ACTION + i] - rest[i],
        );
        let ([ex, ey, ez], [a, b, c, d]) = (error, off);
        let (roll, pitch, goal_x, goal_y) =
            (o[index::ROLL], o[index::PITCH], o[index::SETPOINT_X], o[index::SETPOINT_Y]);
        let signals = [ex, ey, ez, roll, pitch, a, b, c, d, goal_x, goal_y, height];
        x.clear();
        x.extend(turned(sin, cos, error));
        x.extend(turned(sin, cos, e.vel_mps));
        x.extend(turned(sin, cos, e.push_mps2));
        x.extend([wrap(o[index::SETPOINT_YAW] - e.yaw_rad), roll, pitch]);
        x.extend([o[index::ROLL_RATE], o[index::PITCH_RATE], o[index::YAW_RATE]]);
        x.extend(off);
        for (averages, gain) in self.averages.chunks_exact_mut(SIGNALS).zip(&self.policy.gains) {
            let mut from = [R::zero(); SIGNALS];
            for i in 0..SIGNALS {
                let moved = averages[i] + R::from_f64(*gain) * (signals[i] - averages[i]);
                averages[i] = R::select(fresh, signals[i], moved);
                from[i] = signals[i] - averages[i];
            }
            x.extend(turned(sin, cos, [from[0], from[1], from[2]]));
            x.extend_from_slice(&from[3..9]);
            x.extend(turned(sin, cos, [from[9], from[10], from[11]]));
        }
        self.fresh = R::nothing();
    }
}

/// A world vector in the vehicle's heading.
#[inline(always)]
fn turned<R: Scalar>(sin: R, cos: R, [x, y, z]: [R; 3]) -> [R; 3] {
    [cos * x + sin * y, cos * y - sin * x, z]
}

impl<R: Scalar> ControlLaw<R> for Policy<R> {
    fn set_mode(&mut self, mode: Mode) {
        self.landing.set_mode(mode);
    }

    fn reset(&mut self, mask: R::Mask) {
        self.estimator.reset(mask);
        self.fresh = self.fresh | mask;
    }

    #[inline(always)]
    fn act(&mut self, o: &[R; OBSERVATION]) -> [R; ACTION] {
        let estimate = self.estimator.update(o);
        let height = self.landing.target(self.fresh, o[index::SETPOINT_Z], estimate.pos_m[2]);
        let rest = self.interface.action(&Command::level(R::from_f64(self.interface.hover_lift)));
        self.read_signals(o, &estimate, height, &rest);
        let answer = self.policy.network.answer(&mut self.scratch);
        let off = self.interface.action(&Command::level(R::zero()));
        let one = R::from_f64(1.0);
        tabulate(
            #[inline(always)]
            |i| R::select(self.landing.idle, off[i], (rest[i] + answer[i]).clamp(-one, one)),
        )
    }
}
