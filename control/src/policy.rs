//! A trained policy from a file: a multi-layer perceptron, and a linear function beside it, over features of an
//! estimate by the Kalman filter. The file (safetensors) contains the network, the normalisation of its inputs and
//! the time constants of its memory; `crazyflie_gym.policy` writes it, and does the same in Python. Files of the
//! first format fly on: their features are of the marker's last fix, without velocities.

mod export_c;

use std::sync::Arc;

use safetensors::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};

use super::landing::Landing;
use super::{Batch, ControlLaw, ControllerConfig, ControllerContext, Entry, Mode, defaults};
use crazyflie_env::action::{ACTION, Interface};
use crazyflie_env::error::Result;
use crazyflie_env::estimator::{Estimate, Estimator, SensorNoise};
use crazyflie_env::observation::{OBSERVATION, index};
use crazyflie_env::plant::Command;
use crazyflie_env::scalar::{Scalar, tabulate, wrap};

/// There are none: all is in the file.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Options {}

pub(super) const ENTRY: Entry = Entry {
    name: "policy",
    also: None,
    about: "A policy trained by reinforcement learning (`python -m crazyflie_gym.ppo`), flown without Python",
    source: "Proximal policy optimisation (Schulman et al. 2017) with an asymmetric critic (Pinto et al. 2018)",
    any_level: true,
    file: Some("network, normalisation and memory of a policy, as safetensors"),
    member: None,
    options: &[],
    defaults: defaults::<Options>,
    build: |given, site| {
        let Options {} = given.options()?;
        let policy = Policy::new(Network::read(given, site)?, site);
        Ok(Box::new(Batch::new(site.envs, policy)))
    },
};

pub use export_c::{PolicyCode, export_c};

/// A policy's source of position and heading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sight {
    /// The marker's last fix.
    Fix,
    /// The Kalman filter's estimate, with velocity and unexplained acceleration.
    Estimate,
}

/// The formats of files.
const FORMATS: [(&str, Sight); 2] =
    [("crazyflie-policy-2", Sight::Estimate), ("crazyflie-policy-1", Sight::Fix)];
/// Signals with moving averages: position error (3), roll, pitch, last action from level (4), set-point (3).
const SIGNALS: usize = 12;
/// Number of present features: position error (3), velocity (3), push (3), yaw error, roll, pitch, gyro (3), last
/// action from level (4).
const PRESENT: usize = 19;
/// The same of a fix: without velocity and push, with the age of the fix.
const PRESENT_WITH_FIX: usize = 14;
/// Normalised features beyond so many standard deviations are cut off.
const CLIP: f64 = 5.0;
const AGE_MAX_S: f64 = 0.5;
/// Landed: as the package that the thesis flew has it.
const CLEAR_M: f64 = 0.05;
/// More than these is another kind of file.
const MOST_AVERAGES: usize = 8;
const MOST_LAYERS: usize = 8;

/// Weights (inputs rows of outputs) and biases.
#[derive(Debug)]
struct Layer {
    weights: Vec<f32>,
    bias: Vec<f32>,
}

/// Contents of the file.
#[derive(Debug)]
struct Network {
    sight: Sight,
    layers: Vec<Layer>,
    /// The linear function beside the layers: a row of four for each feature; empty if there is none.
    skip: Vec<f32>,
    mean: Vec<f32>,
    std: Vec<f32>,
    /// Gains of the moving averages, per tick.
    gains: Vec<f64>,
}

impl Network {
    /// # Errors
    /// [`crazyflie_env::Error::Config`] naming the tensor that is missing, has another shape or type or contains a
    /// value that is not a number; or that the policy was trained for another tick or cannot command this vertical
    /// form.
    fn read(given: &ControllerConfig<'_>, site: &ControllerContext<'_>) -> Result<Self> {
        let bytes = given.file.unwrap_or_default();
        let bad = |what: String| given.problem(format!("the file of the policy: {what}"));
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| bad(e.to_string()))?;
        let about = |key: &str| header.metadata().as_ref().and_then(|all| all.get(key)).map(String::as_str);
        let format = about("format").unwrap_or("not said");
        let Some((_, sight)) = FORMATS.into_iter().find(|(name, _)| *name == format) else {
            return Err(bad(format!(
                "its format is {format:?}, expected {}",
                FORMATS.map(|(name, _)| format!("{name:?}")).join(" or ")
            )));
        };
        let tick_s: f64 = about("tick_s").and_then(|text| text.parse().ok()).unwrap_or(f64::NAN);
        // half a microsecond for the rounding of a decimal
        if tick_s.is_nan() || (tick_s - site.tick_s).abs() > 5e-7 {
            return Err(bad(format!("it was trained for ticks of {tick_s} s, expected {} s", site.tick_s)));
        }
        if !site.interface.input.is_pwm() {
            return Err(given.problem(
                "it commands a thrust, and a height is asked for: expected the vertical form pwm or thrust",
            ));
        }
        let tensors = SafeTensors::deserialize(bytes).map_err(|e| bad(e.to_string()))?;
        let (taus, _) = tensor(&tensors, "taus_s", 1).map_err(bad)?;
        if !(1..=MOST_AVERAGES).contains(&taus.len()) || taus.iter().any(|tau| *tau < 0.0) {
            return Err(bad(format!("taus_s is {taus:?}, expected 1 to {MOST_AVERAGES} positive times")));
        }
        let present = if sight == Sight::Estimate { PRESENT } else { PRESENT_WITH_FIX };
        let width = present + SIGNALS * taus.len();
        let of_features = |name: &str| match tensor(&tensors, name, 1) {
            Ok((values, _)) if values.len() == width => Ok(values),
            Ok((values, _)) => Err(bad(format!("{name} has {} numbers, expected {width}", values.len()))),
            Err(problem) => Err(bad(problem)),
        };
        let (mean, std) = (of_features("feature_mean")?, of_features("feature_std")?);
        if let Some(zero) = std.iter().find(|std| **std <= 0.0) {
            return Err(bad(format!("feature_std holds {zero}, expected positive numbers")));
        }
        let layers = layers(&tensors, width).map_err(bad)?;
        let skip = match sight {
            Sight::Fix => Vec::new(),
            Sight::Estimate => linear(&tensors, width).map_err(bad)?,
        };
        let gains = taus.iter().map(|tau| tick_s / (f64::from(*tau) + tick_s)).collect();
        Ok(Network { sight, layers, skip, mean, std, gains })
    }
}

/// A tensor of finite single-precision numbers with so many dimensions, and its shape.
fn tensor(
    tensors: &SafeTensors<'_>,
    name: &str,
    dimensions: usize,
) -> std::result::Result<(Vec<f32>, Vec<usize>), String> {
    let view = tensors.tensor(name).map_err(|_| format!("it lacks {name}"))?;
    if view.dtype() != Dtype::F32 || view.shape().len() != dimensions {
        return Err(format!(
            "{name} is {:?} with shape {:?}, expected F32 with {dimensions} dimension(s)",
            view.dtype(),
            view.shape()
        ));
    }
    let (words, _) = view.data().as_chunks::<4>();
    let values: Vec<f32> = words.iter().map(|word| f32::from_le_bytes(*word)).collect();
    match values.iter().find(|value| !value.is_finite()) {
        Some(value) => Err(format!("{name} holds {value}, expected finite numbers")),
        None => Ok((values, view.shape().to_vec())),
    }
}

/// The weights of the linear function from so many features to the action.
fn linear(tensors: &SafeTensors<'_>, features: usize) -> std::result::Result<Vec<f32>, String> {
    let (weights, shape) = tensor(tensors, "skip.weight", 2)?;
    if shape != [features, ACTION] {
        return Err(format!("skip.weight has the shape {shape:?}, expected {:?}", [features, ACTION]));
    }
    Ok(weights)
}

/// `layer0`, `layer1`, ... from so many features to the action.
fn layers(tensors: &SafeTensors<'_>, features: usize) -> std::result::Result<Vec<Layer>, String> {
    let (mut layers, mut inputs) = (Vec::new(), features);
    let names = tensors.names();
    while let name = format!("layer{}", layers.len())
        && names.iter().any(|found| **found == format!("{name}.weight"))
    {
        let (weights, shape) = tensor(tensors, &format!("{name}.weight"), 2)?;
        let (bias, _) = tensor(tensors, &format!("{name}.bias"), 1)?;
        if shape[0] != inputs || shape[1] != bias.len() || bias.is_empty() {
            return Err(format!(
                "{name} has weights {shape:?} and {} biases, expected {inputs} inputs and as many biases as outputs",
                bias.len()
            ));
        }
        inputs = bias.len();
        layers.push(Layer { weights, bias });
    }
    if !(1..=MOST_LAYERS).contains(&layers.len()) || inputs != ACTION {
        let count = layers.len();
        return Err(format!(
            "{count} layers end in {inputs} numbers, expected 1 to {MOST_LAYERS} that end in {ACTION}"
        ));
    }
    Ok(layers)
}

/// The policy of one drone, or of lanes.
#[derive(Debug, Clone)]
struct Policy<R: Scalar> {
    network: Arc<Network>,
    /// The filter whose estimate is seen; none for a policy that sees fixes.
    estimator: Option<Estimator<R>>,
    interface: Interface,
    mode: Mode,
    /// Landing of a policy that uses an estimate.
    landing: Landing<R>,
    /// Moving averages, [`SIGNALS`] for each time constant.
    averages: Vec<R>,
    /// Inputs and outputs of a layer.
    layer: [Vec<R>; 2],
    idle: R::Mask,
    fresh: R::Mask,
}

impl<R: Scalar> Policy<R> {
    fn new(network: Network, site: &ControllerContext<'_>) -> Self {
        let widest =
            network.layers.iter().map(|layer| layer.bias.len()).max().unwrap_or(0).max(network.mean.len());
        let none = R::nothing();
        Policy {
            averages: vec![R::zero(); SIGNALS * network.gains.len()],
            layer: [0, 1].map(|_| Vec::with_capacity(widest)),
            estimator: (network.sight == Sight::Estimate).then(|| {
                Estimator::new(site.model, site.interface.input, site.tick_s, &SensorNoise::default())
            }),
            network: Arc::new(network),
            interface: site.interface,
            mode: site.mode,
            landing: Landing::new(site.mode, site.tick_s),
            idle: none,
            fresh: !none,
        }
    }

    /// The features of a row go into the first layer.
    #[inline(always)]
    fn read_signals(&mut self, o: &[R; OBSERVATION], sight: &Pose<R>, height: R, rest: &[R; ACTION]) {
        let (fresh, x) = (self.fresh, &mut self.layer[0]);
        let (sin, cos) = sight.yaw_rad.sin_cos();
        let [px, py, pz] = sight.pos_m;
        let error = [o[index::SETPOINT_X] - px, o[index::SETPOINT_Y] - py, height - pz];
        let off: [R; ACTION] = tabulate(
            #[inline(always)]
            |i| o[index::LAST_ACTION + i] - rest[i],
        );
        let signals = [
            error[0],
            error[1],
            error[2],
            o[index::ROLL],
            o[index::PITCH],
            off[0],
            off[1],
            off[2],
            off[3],
            o[index::SETPOINT_X],
            o[index::SETPOINT_Y],
            height,
        ];
        x.clear();
        x.extend(turned(sin, cos, error));
        if let Some((vel_mps, push_mps2)) = sight.motion {
            x.extend(turned(sin, cos, vel_mps));
            x.extend(turned(sin, cos, push_mps2));
        }
        x.extend([
            wrap(o[index::SETPOINT_YAW] - sight.yaw_rad),
            o[index::ROLL],
            o[index::PITCH],
            o[index::ROLL_RATE],
            o[index::PITCH_RATE],
            o[index::YAW_RATE],
            off[0],
            off[1],
            off[2],
            off[3],
        ]);
        if sight.motion.is_none() {
            x.push(o[index::MARKER_AGE].min(R::from_f64(AGE_MAX_S)));
        }
        for (averages, gain) in self.averages.chunks_exact_mut(SIGNALS).zip(&self.network.gains) {
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

    /// Through the network.
    #[inline(always)]
    fn think(&mut self) -> [R; ACTION] {
        let Network { layers, skip, mean, std, .. } = &*self.network;
        let [x, y] = &mut self.layer;
        for ((x, mean), std) in x.iter_mut().zip(mean).zip(std) {
            *x = ((*x - R::from_f64((*mean).into())) / R::from_f64((*std).into()))
                .clamp(R::from_f64(-CLIP), R::from_f64(CLIP));
        }
        let mut linear = [R::zero(); ACTION];
        for (x, weights) in x.iter().zip(skip.as_chunks::<ACTION>().0) {
            linear.iter_mut().zip(weights).for_each(|(y, weight)| *y += *x * R::from_f64((*weight).into()));
        }
        for (i, layer) in layers.iter().enumerate() {
            y.clear();
            y.extend(layer.bias.iter().map(|bias| R::from_f64((*bias).into())));
            for (x, weights) in x.iter().zip(layer.weights.chunks_exact(layer.bias.len())) {
                y.iter_mut().zip(weights).for_each(|(y, weight)| *y += *x * R::from_f64((*weight).into()));
            }
            if i + 1 < layers.len() {
                y.iter_mut().for_each(|y| *y = tanh(*y));
            }
            std::mem::swap(x, y);
        }
        tabulate(
            #[inline(always)]
            |i| x[i] + linear[i],
        )
    }
}

/// Position of the vehicle, and its motion as far as that is known.
struct Pose<R> {
    pos_m: [R; 3],
    yaw_rad: R,
    /// Velocity and unexplained acceleration, of an estimate.
    motion: Option<([R; 3], [R; 3])>,
}

impl<R: Scalar> Pose<R> {
    #[inline(always)]
    fn from_estimate(e: &Estimate<R>) -> Self {
        Pose { pos_m: e.pos_m, yaw_rad: e.yaw_rad, motion: Some((e.vel_mps, e.push_mps2)) }
    }

    /// The last fix in a row.
    #[inline(always)]
    fn from_fix(o: &[R; OBSERVATION]) -> Self {
        let pos_m = [o[index::MARKER_X], o[index::MARKER_Y], o[index::MARKER_Z]];
        Pose { pos_m, yaw_rad: o[index::MARKER_YAW], motion: None }
    }
}

/// A world vector in the vehicle's heading.
#[inline(always)]
fn turned<R: Scalar>(sin: R, cos: R, [x, y, z]: [R; 3]) -> [R; 3] {
    [cos * x + sin * y, cos * y - sin * x, z]
}

/// Absolute error below 3e-7 in `f32`.
#[inline(always)]
fn tanh<R: Scalar>(x: R) -> R {
    R::from_f64(1.0) - R::from_f64(2.0) / ((x + x).exp() + R::from_f64(1.0))
}

impl<R: Scalar> ControlLaw<R> for Policy<R> {
    fn set_mode(&mut self, mode: Mode) {
        self.mode = mode;
        self.landing.set_mode(mode);
    }

    fn reset(&mut self, mask: R::Mask) {
        if let Some(estimator) = &mut self.estimator {
            estimator.reset(mask);
        }
        self.fresh = self.fresh | mask;
        self.idle = self.idle & !mask;
    }

    #[inline(always)]
    fn act(&mut self, o: &[R; OBSERVATION]) -> [R; ACTION] {
        let sight = match &mut self.estimator {
            Some(estimator) => Pose::from_estimate(&estimator.update(o)),
            None => Pose::from_fix(o),
        };
        let mut height = o[index::SETPOINT_Z];
        if sight.motion.is_some() {
            height = self.landing.target(self.fresh, height, sight.pos_m[2]);
            self.idle = self.landing.idle;
        } else if self.mode == Mode::Landing {
            height = R::from_f64(CLEAR_M);
            self.idle = self.idle | sight.pos_m[2].le(height);
        }
        let rest = self.interface.action(&Command::level(R::from_f64(self.interface.hover_lift)));
        self.read_signals(o, &sight, height, &rest);
        let thought = self.think();
        let off = self.interface.action(&Command::level(R::zero()));
        let one = R::from_f64(1.0);
        tabulate(
            #[inline(always)]
            |i| R::select(self.idle, off[i], (rest[i] + thought[i]).clamp(-one, one)),
        )
    }
}
