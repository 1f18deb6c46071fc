//! A load on a thread, found by its swing. An accelerometer feels no gravity, so along the body it shows the pull of
//! the thread and the drag alone. Without one, motion capture shows them: acceleration less the thrust's, which leans
//! as the vehicle does. The motion of the vehicle drives a pendulum of a given length; the pull of the length that
//! accounts for most of that force gives the mass. No model of the vehicle is needed.

use std::f64::consts::TAU;

use crazyflie_env::effects::{Entry, Observability, registry};
use crazyflie_env::model::Model;
use crazyflie_logs::{AttitudeSource, PositionSource};
use nalgebra::{Matrix3, Matrix4, SMatrix, SVector, Vector2};
use rayon::prelude::*;

use crate::explain::calibration::swing::{
    AGREES, BAND_M, CUT_S, DAMPINGS_PS, FINE_S, INDEPENDENT_S, KNOT_M, LEAST_RATIO, LEAST_SHARE,
    LEAST_SWINGS, LENGTHS, STEPS,
};
use crate::explain::verdict::{EffectParameterEstimate, Finding};
use crate::fit::hypothesis::Term;
use crate::replay::measurements::interpolate;
use crate::{FlightLog, NamedLog};

const G_MPS2: f64 = 9.81;
/// Time between the samples of a series, once it is smooth.
const STEP_S: f64 = FINE_S * STEPS as f64;

/// Motion and force of one flight along one axis of the world, smoothed alike.
struct Series {
    vel_mps: Vec<f64>,
    /// Acceleration of the knot, below the centre of mass.
    knot_mps2: Vec<f64>,
    /// Tilt of the thrust towards the axis.
    lean_rad: Vec<f64>,
    force_mps2: Vec<f64>,
    /// Share of a wandering force that lasts for a step, which the fit takes out; 0 for an accelerometer, on whose flights
    /// the search was set without. Wander drives the pendulum too: only what is new of it is independent of the swing.
    persistence: f64,
}

/// A pendulum that was tried, with sums of squares and products of each series: see [`Series::squares`].
struct PendulumSums {
    /// Place in the searched lengths.
    place: usize,
    length_m: f64,
    damping_ps: f64,
    squares: Vec<[Matrix3<f64>; 2]>,
}

/// The pendulum that leaves least of the force.
#[derive(Clone, Copy)]
struct Pendulum {
    place: usize,
    length_m: f64,
    damping_ps: f64,
    mass_ratio: f64,
    /// Share of the force beside drag and the first swing that its pull accounts for.
    share: f64,
}

/// A load that swings below a vehicle, estimated from the forces of all flights: a pendulum that pulls alike in those of
/// the fit and of the test.
pub(super) struct Swing {
    entry: &'static Entry,
    pendulum: Pendulum,
    /// Standard errors of the mass ratio and of the length, each flight and axis left out in turn.
    stderr: [f64; 2],
    /// Log-likelihood that the pendulum is worth, on the flights of the fit and on those of the test.
    worth: [f64; 2],
}

/// The load below a vehicle, as flights show it.
pub(super) enum Load {
    /// They do not show forces.
    Unseen,
    /// Nothing swings, or the model declares it.
    Absent,
    /// It swings.
    Swings(Swing),
}

impl Load {
    /// A load that swings in the flights of the fit and, with the same thread, in those of the test.
    pub(super) fn new(model: &Model, fit: &[NamedLog], test: &[NamedLog]) -> Self {
        if !fit.iter().chain(test).all(shows_swing) {
            return Load::Unseen;
        }
        let is_open =
            |e: &&Entry| e.observability == Observability::Resonant && !model.effects.contains_key(e.name);
        let Some(entry) = registry().iter().find(is_open) else { return Load::Absent };
        let all: Vec<Series> = fit.iter().chain(test).flat_map(|(_, log)| series(log)).collect();
        find(entry, &all, 2 * fit.len()).map_or(Load::Absent, Load::Swings)
    }

    pub(super) fn swing(&self) -> Option<&Swing> {
        if let Load::Swings(swing) = self { Some(swing) } else { None }
    }
}

/// The same in series, of which the first ones are those of the fit.
fn find(entry: &'static Entry, all: &[Series], fitted: usize) -> Option<Swing> {
    let tried = try_all(all);
    let pendulum = nearest(&tried, |_| true)?;
    let known = nearest(&tried, |s| s < fitted)?;
    let same: Vec<&PendulumSums> = tried.iter().filter(|t| t.place == known.place).collect();
    let confirmed = nearest(same.iter().copied(), |s| s >= fitted)?;
    let is_clear = |p: &Pendulum| p.share > LEAST_SHARE && p.mass_ratio > LEAST_RATIO;
    // a length at the edge of the band is that of something else
    let is_inside = |p: &Pendulum| p.place > 0 && p.place + 1 < LENGTHS;
    let agree = (1.0 / AGREES..AGREES).contains(&(confirmed.mass_ratio / known.mass_ratio));
    let is_load = [pendulum, known, confirmed].iter().all(|p| is_clear(p) && is_inside(p)) && agree;
    let worth = |p: &Pendulum, all: &[Series]| {
        let samples: usize = all.iter().map(|s| s.vel_mps.len()).sum();
        -0.5 * samples as f64 * STEP_S / INDEPENDENT_S * (1.0 - p.share).ln()
    };
    is_load.then(|| Swing {
        entry,
        pendulum,
        stderr: standard_errors(&tried, all.len()),
        worth: [worth(&known, &all[..fitted]), worth(&confirmed, &all[fitted..])],
    })
}

impl Swing {
    /// The effect, at values that no fit of windows moves: in two seconds all lengths look alike.
    pub(super) fn term(&self) -> Term {
        let Pendulum { mass_ratio, length_m, damping_ps, .. } = self.pendulum;
        // the hover thrust is fitted: it holds the weight of the load
        let values = vec![mass_ratio, length_m + KNOT_M, damping_ps, 1.0];
        Term { values, ..Term::without_free(self.entry) }
    }

    /// The values, with the mass of the load and the frequency of its swing. `declared_kg` is what the model declares,
    /// and `holds_load` whether that is the weight of both.
    pub(super) fn estimates(&self, declared_kg: f64, holds_load: bool) -> Vec<EffectParameterEstimate> {
        let Pendulum { mass_ratio, length_m, damping_ps, .. } = self.pendulum;
        let [ratio_sd, length_sd] = self.stderr;
        let thread_m = length_m + KNOT_M;
        let load_kg = declared_kg * mass_ratio / if holds_load { 1.0 + mass_ratio } else { 1.0 };
        let frequency_hz = (G_MPS2 / thread_m).sqrt() / TAU;
        let estimate =
            |name, value, stderr, unit| EffectParameterEstimate { name, value, stderr, unit, declared: 0.0 };
        let [ratio, length, damping] = [0, 1, 2].map(|i| &self.entry.params[i]);
        vec![
            estimate(ratio.name, mass_ratio, ratio_sd, ratio.unit),
            estimate(length.name, thread_m, length_sd, length.unit),
            estimate(damping.name, damping_ps, f64::NAN, damping.unit),
            estimate("load_kg", load_kg, load_kg * ratio_sd / mass_ratio, "kg"),
            estimate("frequency_hz", frequency_hz, 0.5 * frequency_hz * length_sd / thread_m, "Hz"),
        ]
    }

    pub(super) fn effect(&self) -> &'static str {
        self.entry.name
    }

    /// The load as a finding, with what predictions lose on each axis without it.
    pub(super) fn finding(
        &self,
        params: Vec<EffectParameterEstimate>,
        [sideways, vertical, tilt]: [f64; 3],
    ) -> Finding {
        Finding {
            name: self.entry.name,
            params,
            confusable_with: Vec::new(),
            manoeuvre: String::new(),
            worth_fit: self.worth[0],
            worth_test: self.worth[1],
            worth_by_signal: [sideways, vertical, tilt, 0.0],
            with: Vec::new(),
        }
    }

    /// Returns whether a hover thrust that is so many times the declared one carries a load that the declared one
    /// does not.
    pub(super) fn is_carried_beside(&self, thrust_share: f64) -> bool {
        thrust_share > 1.0 + 0.5 * self.pendulum.mass_ratio
    }
}

/// When a log begins and ends to fly.
fn flown_s(log: &FlightLog) -> [f64; 2] {
    log.t_s.get(log.airborne.clone()).map_or([0.0; 2], |t_s| [t_s[0], t_s[t_s.len() - 1]])
}

/// Returns whether a flight under motion capture shows the force beside its thrust: by an accelerometer on the clock of
/// the position, or by angles that motion capture measured. (A vehicle's own estimate takes that force for tilt.)
fn shows_swing((_, log): &NamedLog) -> bool {
    let [first_s, last_s] = flown_s(log);
    (log.acc_mps2.is_some() || log.provenance.attitude == AttitudeSource::MotionCapture)
        && log.provenance.position == PositionSource::MotionCapture
        && !log.provenance.onboard_interpolated
        && last_s - first_s > LEAST_SWINGS
}

/// Both axes of a flight.
fn series(log: &FlightLog) -> [Series; 2] {
    let [first_s, last_s] = flown_s(log);
    let count = ((last_s - first_s) / FINE_S) as usize;
    let at = |i: usize| first_s + i as f64 * FINE_S;
    let sampled = |value: &dyn Fn(f64) -> f64| smooth((0..count).map(|i| value(at(i))).collect());
    let row = |v: &[f64], t_s: f64| interpolate(&log.t_s, v, t_s);
    let heading = |t_s: f64| row(&log.yaw_rad, t_s).sin_cos();
    let position_m =
        |axis: usize| sampled(&|t| interpolate(&log.fixes.capture_t_s, &log.fixes.pos_m[axis], t));
    let climb_mps2 = slope(&slope(&position_m(2)));
    let axis = |axis: usize| {
        // forwards and to the left, seen along the axis
        let along = |t_s: f64, front: f64, left: f64| {
            let (sin, cos) = heading(t_s);
            if axis == 0 { cos * front - sin * left } else { sin * front + cos * left }
        };
        let lean_rad = sampled(&|t| along(t, row(&log.pitch_rad, t), -row(&log.roll_rad, t)));
        let vel_mps = slope(&position_m(axis));
        let (acc_mps2, turn_radps2) = (slope(&vel_mps), slope(&slope(&lean_rad)));
        let knot_mps2: Vec<f64> =
            acc_mps2.iter().zip(&turn_radps2).map(|(a, turn)| a - KNOT_M * turn).collect();
        let beside_thrust = |i: usize| acc_mps2[i] - (G_MPS2 + climb_mps2[i]) * lean_rad[i].tan();
        let (force_mps2, persistence) = match &log.acc_mps2 {
            Some(felt) => (sampled(&|t| along(t, row(&felt[0], t), row(&felt[1], t))), 0.0),
            None => ((0..acc_mps2.len()).map(beside_thrust).collect(), (-STEP_S / INDEPENDENT_S).exp()),
        };
        let [vel_mps, knot_mps2, lean_rad, force_mps2] =
            [vel_mps, knot_mps2, lean_rad, force_mps2].map(|v| v.into_iter().step_by(STEPS).collect());
        Series { vel_mps, knot_mps2, lean_rad, force_mps2, persistence }
    };
    [axis(0), axis(1)]
}

/// Three running means in turn: a low pass without a lag.
fn smooth(mut values: Vec<f64>) -> Vec<f64> {
    let width = (CUT_S / FINE_S).round() as usize;
    for _ in 0..3 {
        values = values.windows(width).map(|near| near.iter().sum::<f64>() / width as f64).collect();
    }
    values
}

/// The slope by central differences, those at the ends by one neighbour.
fn slope(values: &[f64]) -> Vec<f64> {
    let last = values.len().saturating_sub(1);
    let at = |i: usize| {
        let (before, after) = (i.saturating_sub(1), (i + 1).min(last));
        (values[after] - values[before]) / (FINE_S * (after - before).max(1) as f64)
    };
    (0..values.len()).map(at).collect()
}

impl Series {
    /// Sums of squares and products of the pull per mass ratio, the drag per rate and the force, without what an
    /// offset, a drift and the swing at the start account for: of all, and of what is new in each step.
    fn squares(&self, length_m: f64, damping_ps: f64) -> Option<[Matrix3<f64>; 2]> {
        let stiffness = G_MPS2 / length_m;
        let swing = (stiffness - 0.25 * damping_ps * damping_ps).max(0.0).sqrt();
        let (mut sums, mut before) = ([SMatrix::<f64, 7, 7>::zeros(); 2], SVector::zeros());
        for (k, apart_m) in respond(&self.knot_mps2, stiffness, damping_ps).iter().enumerate() {
            let t_s = k as f64 * STEP_S;
            let (sin, cos) = (swing * t_s).sin_cos();
            let decay = (-0.5 * damping_ps * t_s).exp();
            let pull = G_MPS2 * (self.lean_rad[k] + apart_m / length_m);
            let [drag, force] = [-self.vel_mps[k], self.force_mps2[k]];
            let row = SVector::from([1.0, t_s, decay * cos, decay * sin, pull, drag, force]);
            let fresh = row - self.persistence * before;
            sums[0] += row * row.transpose();
            if k > 0 || self.persistence == 0.0 {
                sums[1] += fresh * fresh.transpose();
            }
            before = row;
        }
        let [all, fresh] = sums.map(|sums| {
            let own: Matrix4<f64> = sums.fixed_view::<4, 4>(0, 0).into_owned();
            let coupling = sums.fixed_view::<4, 3>(0, 4).into_owned();
            let rest: Matrix3<f64> = sums.fixed_view::<3, 3>(4, 4).into_owned();
            Some(rest - coupling.transpose() * own.try_inverse()? * coupling)
        });
        Some([all?, fresh?])
    }
}

/// Computes the displacement of a load below a knot with these accelerations, from rest: a pendulum by the bilinear
/// rule.
fn respond(knot_mps2: &[f64], stiffness: f64, damping_ps: f64) -> Vec<f64> {
    let k = 2.0 / STEP_S;
    let (now, before) = (k * k + damping_ps * k + stiffness, 2.0 * (stiffness - k * k));
    let earlier = k * k - damping_ps * k + stiffness;
    let mut apart_m = vec![0.0; knot_mps2.len()];
    for i in 2..knot_mps2.len() {
        let drive = knot_mps2[i] + 2.0 * knot_mps2[i - 1] + knot_mps2[i - 2];
        apart_m[i] = (-drive - before * apart_m[i - 1] - earlier * apart_m[i - 2]) / now;
    }
    apart_m
}

/// Every length of the band with every damping.
fn try_all(all: &[Series]) -> Vec<PendulumSums> {
    let [shortest_m, longest_m] = BAND_M;
    let tried = |place: usize, damping_ps: f64| {
        let length_m = shortest_m * (longest_m / shortest_m).powf(place as f64 / (LENGTHS - 1) as f64);
        let squares = all.iter().map(|s| s.squares(length_m, damping_ps)).collect::<Option<_>>()?;
        Some(PendulumSums { place, length_m, damping_ps, squares })
    };
    (0..LENGTHS)
        .into_par_iter()
        .flat_map_iter(|place| DAMPINGS_PS.into_iter().filter_map(move |damping_ps| tried(place, damping_ps)))
        .collect()
}

/// The pendulum that leaves least of the force in the series that are taken.
fn nearest<'a>(
    tried: impl IntoIterator<Item = &'a PendulumSums>,
    takes: impl Fn(usize) -> bool,
) -> Option<Pendulum> {
    let fitted = |t: &PendulumSums| {
        let PendulumSums { place, length_m, damping_ps, .. } = *t;
        let [all, fresh] = [0, 1].map(|part| -> Matrix3<f64> {
            t.squares.iter().enumerate().filter(|(s, _)| takes(*s)).map(|(_, sums)| sums[part]).sum()
        });
        let towards = |sums: &Matrix3<f64>| Vector2::new(sums[(0, 2)], sums[(1, 2)]);
        let inverse = |sums: &Matrix3<f64>| sums.fixed_view::<2, 2>(0, 0).into_owned().try_inverse();
        let left =
            |sums: &Matrix3<f64>| Some(sums[(2, 2)] - towards(sums).dot(&(inverse(sums)? * towards(sums))));
        let share = 1.0 - left(&all)? / (all[(2, 2)] - all[(1, 2)].powi(2) / all[(1, 1)]);
        let mass_ratio = (inverse(&fresh)? * towards(&fresh))[0];
        Some((left(&fresh)?, Pendulum { place, length_m, damping_ps, mass_ratio, share }))
    };
    let all = tried.into_iter().filter_map(fitted);
    all.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, pendulum)| pendulum)
}

/// Standard errors of mass ratio and length by the jackknife over flights and axes.
fn standard_errors(tried: &[PendulumSums], series: usize) -> [f64; 2] {
    let values: Vec<_> = (0..series).filter_map(|left_out| nearest(tried, |s| s != left_out)).collect();
    let n = values.len() as f64;
    [|p: &Pendulum| p.mass_ratio, |p: &Pendulum| p.length_m].map(|number| {
        let mean = values.iter().map(number).sum::<f64>() / n;
        ((n - 1.0) / n * values.iter().map(|p| (number(p) - mean).powi(2)).sum::<f64>()).sqrt()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A vehicle that flies to and fro for 16 s, with a load of this mass ratio on a thread, and a force that wanders so
    /// far (m/s^2).
    fn flown(seed: u64, thread_m: f64, ratio: f64, wander_mps2: f64) -> Series {
        let length_m = thread_m - KNOT_M;
        let mut state = seed;
        let mut noise = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1_u32 << 30) - 1.0
        };
        let (mut x, mut v, mut load, mut load_v, mut gust, mut lean, mut turn) =
            (0.0, 0.0, 0.02, 0.0, 0.0, 0.0, 0.0);
        let hz = 0.2 + 0.03 * (seed % 5) as f64;
        let [vel_mps, knot_mps2, lean_rad, force_mps2] = [const { Vec::new() }; 4];
        let mut flown = Series { vel_mps, knot_mps2, lean_rad, force_mps2, persistence: 0.0 };
        for i in 0..16_000 {
            let t_s = f64::from(i) * 1e-3;
            let wanted = 0.5 * (TAU * hz * t_s).sin().signum();
            turn += 1e-3
                * (150.0 * (((4.0 * (wanted - x) - 3.0 * v) / G_MPS2).clamp(-0.2, 0.2) - lean) - 14.0 * turn);
            lean += 1e-3 * turn;
            let pull = ratio * G_MPS2 * ((load - x) / length_m + lean);
            gust += 1e-3 * (-gust / 0.5 + 110.0 * wander_mps2 * noise());
            let acc = G_MPS2 * lean + pull - 0.3 * v + gust;
            if i % 20 == 0 {
                flown.vel_mps.push(v);
                flown.knot_mps2.push(acc);
                flown.lean_rad.push(lean);
                flown.force_mps2.push(acc - G_MPS2 * lean + 0.02 * noise());
            }
            load_v -= 1e-3 * G_MPS2 / length_m * (load - x);
            (x, v) = (x + 1e-3 * v, v + 1e-3 * acc);
            load += 1e-3 * load_v;
        }
        flown
    }

    /// Two flights of the fit and two of the test, one axis each.
    fn found(length_m: f64, ratio: f64) -> Option<Swing> {
        let flights: Vec<Series> = (1..5).map(|seed| flown(seed, length_m, ratio, 0.027)).collect();
        find(&registry()[0], &flights, 2)
    }

    #[test]
    fn the_pull_of_a_thread_tells_its_length_and_the_mass_of_the_load() {
        let Pendulum { length_m, mass_ratio, .. } = found(0.5, 0.14).unwrap().pendulum;
        assert!((length_m + KNOT_M - 0.5).abs() < 0.025, "{length_m}");
        assert!((mass_ratio - 0.14).abs() < 0.014, "{mass_ratio}");
    }

    #[test]
    fn the_motion_alone_tells_the_same_load_in_air_that_shakes_it() {
        let of_flight = |seed| Series { persistence: 0.9, ..flown(seed, 0.5, 0.14, 0.2) };
        let pendulum = nearest(&try_all(&(1..9).map(of_flight).collect::<Vec<_>>()), |_| true).unwrap();
        assert!((pendulum.length_m + KNOT_M - 0.5).abs() < 0.025, "{}", pendulum.length_m);
        assert!((pendulum.mass_ratio - 0.14).abs() < 0.014, "{}", pendulum.mass_ratio);
    }

    #[test]
    fn a_force_that_wanders_and_a_thread_at_the_edge_of_the_band_are_no_load() {
        assert!(found(0.5, 0.0).is_none());
        assert!(found(BAND_M[0] + KNOT_M, 0.14).is_none());
    }
}
