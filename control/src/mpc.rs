//! Linear model-predictive control with the limits of the commands.

use serde::{Deserialize, Serialize};

use super::batch::{check, mask, rows, write};
use super::lqr::{self, OPTIONS};
use super::observer::{DiscreteModel, Observer, TrackingError};
use super::qp::Horizon;
use super::riccati::regulator;
use super::{Controller, ControllerContext, Entry, Mode, defaults};
use crazyflie_env::action::ACTION;
use crazyflie_env::error::Result;
use crazyflie_env::lanes::{LANES, Lanes};
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::plant::Command;
use crazyflie_env::scalar::{Scalar, dot};

/// The options of the LQR, whose cost is the terminal cost beyond the horizon.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
#[serde(transparent)]
struct Options(lqr::Options);

pub(super) const ENTRY: Entry = Entry {
    name: "mpc",
    also: None,
    about: "Linear model-predictive control: the LQR's costs over one second ahead, with the limits of tilt and lift as constraints of a quadratic program",
    source: "Condensed form with blocked moves and the Riccati solution as the terminal cost; Maciejowski, Predictive Control with Constraints, 2002; solver \
             Clarabel (Goulart, Chen 2024)",
    any_level: false,
    file: None,
    member: None,
    options: OPTIONS,
    defaults: defaults::<Options>,
    build: |given, site| Ok(Box::new(Mpc::new(given.options::<Options>()?.0, site)?)),
};

/// The states that a command moves, and the command: x by pitch, y by roll, z by lift.
const AXES: [(&[usize], usize); 3] = [(&[0, 4, 6, 10], 1), (&[1, 3, 7, 9], 0), (&[2, 8], 3)];

struct Mpc {
    tiles: Vec<Observer<Lanes>>,
    horizons: [Horizon; 3],
    /// Gain of the heading, which has no limit worth planning for.
    yaw_gain: [Lanes; 12],
    /// Greatest command of each axis of [`AXES`], least.
    most: [f64; 3],
    least: [f64; 3],
    reach_m: f64,
    envs: usize,
}

impl Mpc {
    fn new(options: lqr::Options, site: &ControllerContext<'_>) -> Result<Self> {
        let model = DiscreteModel::from_context(site)?;
        let (q, r) = options.costs(site);
        let gain = regulator(&model.a, &model.b, &q, &r)?;
        let horizon = |(states, input): (&[usize], usize)| Horizon::new(&model, states, input, &q, r[input]);
        let [x, y, z] = AXES;
        let observer = Observer::new(site, &model, &options.belief)?;
        let tilt = site.interface.tilt_max_rad;
        Ok(Mpc {
            tiles: vec![observer; site.envs.div_ceil(LANES)],
            horizons: [horizon(x)?, horizon(y)?, horizon(z)?],
            yaw_gain: std::array::from_fn(|i| Lanes::from_f64(gain[(2, i)])),
            most: [tilt, tilt, site.interface.lift_max],
            least: [-tilt, -tilt, 0.0],
            reach_m: options.reach_m,
            envs: site.envs,
        })
    }
}

/// One lane's first moves: pitch, roll, lift.
fn plan(
    horizons: &mut [Horizon; 3],
    limits: [&[f64; 3]; 2],
    reach_m: f64,
    seen: &TrackingError<Lanes>,
    lane: usize,
) -> [f64; 3] {
    let still = [seen.still.pitch_rad, seen.still.roll_rad, seen.still.lift].map(|u| u.lane(lane));
    std::array::from_fn(|axis| {
        let mut x = [0.0; 4];
        for (slot, state) in x.iter_mut().zip(AXES[axis].0) {
            *slot = seen.off[*state].lane(lane);
        }
        x[0] = x[0].clamp(-reach_m, reach_m);
        let within = [limits[0][axis] - still[axis], limits[1][axis] - still[axis]];
        still[axis] + horizons[axis].first_move(&x, within)
    })
}

impl Controller for Mpc {
    fn set_mode(&mut self, mode: Mode) {
        self.tiles.iter_mut().for_each(|observer| observer.set_mode(mode));
    }

    fn reset(&mut self, of: &dyn Fn(usize) -> bool) {
        for (tile, observer) in self.tiles.iter_mut().enumerate() {
            observer.reset(mask(tile, self.envs, of));
        }
    }

    fn act(&mut self, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        check(self.envs, observations, actions)?;
        let tiles = observations.chunks(LANES * OBSERVATION).zip(actions.chunks_mut(LANES * ACTION));
        for (observer, (seen_rows, out)) in self.tiles.iter_mut().zip(tiles) {
            let seen = observer.update(&rows(seen_rows));
            let mut u = Command { yaw_rate_radps: -dot(&self.yaw_gain, seen.off), ..seen.still };
            for lane in 0..out.len() / ACTION {
                let [pitch, roll, lift] =
                    plan(&mut self.horizons, [&self.least, &self.most], self.reach_m, &seen, lane);
                u.pitch_rad.set_lane(lane, pitch);
                u.roll_rad.set_lane(lane, roll);
                u.lift.set_lane(lane, lift);
            }
            write(&observer.action(&u, seen.idle), out, ACTION);
        }
        Ok(())
    }
}
