//! The flights of section 7.3: closed loop, old gains against new.

use crazyflie_control::ControllerSpec;
use crazyflie_env::Error;
use crazyflie_env::action::ActionLevel;
use crazyflie_env::config::EffectTable;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::vector::state_index;
use crazyflie_statistics::{mean, quantile};

use super::{Claim, ScorecardRow, about, figure};
use crazyflie_server::flight::{FlightEnd, FlightScenario, Setup, Trace, fly, lab_rig};

type ExperimentFn = fn(&Model) -> Result<Vec<ScorecardRow>, Error>;

pub(super) const EXPERIMENTS: &[ExperimentFn] = &[fly_80_cm, takeoff, takeoff_by_thrust, hover];

/// Old: `crazyflie_ros` defaults, which the thesis does not print. New: table 7.1.
pub(super) const GAINS: [(&str, &str); 2] = [("old", "stock-pid"), ("new", "thesis-pid")];
/// The rig's figures are medians over so many seeds.
const SEEDS: u64 = 15;
/// "Over the marker": within half its side of 197 mm.
const MARKER_M: f64 = 0.0985;
/// The height counts as stable within this.
const BAND_M: f64 = 0.05;

/// A flight with the true position, and several through the lab's camera.
pub(super) struct Pair {
    pub ideal: Trace,
    pub rig: Vec<Trace>,
}

pub(super) fn fly_pair(
    model: &Model,
    name: &str,
    controller: &str,
    vertical: VerticalInput,
) -> Result<Pair, Error> {
    let scenario = FlightScenario::find(name)?;
    let ideal = Setup {
        model: model.clone(),
        scenario,
        task_options: None,
        own: None,
        action: ActionLevel::Attitude,
        controller: ControllerSpec::named(controller)?,
        effects: EffectTable::new(),
        vertical,
        seconds: scenario.seconds,
    };
    let seeds: Vec<u64> = (0..SEEDS).collect();
    let rig = fly(&Setup { effects: lab_rig(), ..ideal.clone() }, &seeds)?;
    Ok(Pair { ideal: fly(&ideal, &[0])?.swap_remove(0), rig })
}

/// Combines the values of the rig's seeds into one figure.
type Aggregate = fn(&[f64]) -> Option<f64>;

/// The middle one: a value that a flight has.
fn middle(values: &[f64]) -> Option<f64> {
    quantile(values, 0.5)
}

/// One measured quantity of a flight with one of the gains.
struct Measure {
    gains: &'static str,
    quantity: &'static str,
    unit: &'static str,
    decimals: usize,
    quantity_of: fn(&Trace) -> f64,
    claim: Claim,
    aggregate: Aggregate,
    /// Nothing happens without noise: no figure for the true position.
    quiet: bool,
    why: &'static str,
}

fn lines(
    model: &Model,
    (place, experiment): (&'static str, &'static str),
    (name, vertical): (&str, VerticalInput),
    measures: &[Measure],
) -> Result<Vec<ScorecardRow>, Error> {
    let mut all = Vec::new();
    for (label, gains) in GAINS {
        let pair = fly_pair(model, name, gains, vertical)?;
        for a in measures.iter().filter(|a| a.gains == label) {
            all.push(ScorecardRow {
                place,
                experiment,
                gains: label,
                quantity: a.quantity,
                claim: a.claim.clone(),
                ideal: if a.quiet { None } else { figure((a.quantity_of)(&pair.ideal), a.unit, a.decimals) },
                rig: figure(
                    (a.aggregate)(&pair.rig.iter().map(a.quantity_of).collect::<Vec<_>>())
                        .unwrap_or(f64::NAN),
                    a.unit,
                    a.decimals,
                ),
                why: a.why,
            });
        }
    }
    Ok(all)
}

const LOW_MARGIN: &str = "under 2 degrees of phase margin, none from 10 ms of delay on";
const SOME_MARGIN: &str =
    "19 degrees of phase margin, 9 with 77 ms of delay: 5.1 and 5.5 oscillate with these gains";

/// The share of flights that ended outside the room.
fn leaves(gains: &'static str, why: &'static str, quiet: bool) -> Measure {
    let quantity_of: fn(&Trace) -> f64 = |t| if t.end == FlightEnd::LeftRoom { 100.0 } else { 0.0 };
    let claim = Claim::AtMost(0.0, "no");
    Measure {
        gains,
        quantity: "leaves the room",
        unit: "% of flights",
        decimals: 0,
        quantity_of,
        claim,
        aggregate: mean,
        quiet,
        why,
    }
}

/// Figures 7.4 to 7.8.
fn fly_80_cm(model: &Model) -> Result<Vec<ScorecardRow>, Error> {
    let overshoot: fn(&Trace) -> f64 = |t| 100.0 * beyond(&t.state(0), 0.8, 0.0);
    let stable: fn(&Trace) -> f64 = |t| stable_s(&t.state(0), 0.0, MARKER_M, t.tick_s);
    let measure = |gains, quantity, unit, quantity_of, claim, why| Measure {
        gains,
        quantity,
        unit,
        decimals: 1,
        quantity_of,
        claim,
        aggregate: middle,
        quiet: false,
        why,
    };
    let measures = [
        measure("old", "overshoot", "cm", overshoot, about(50.0, "almost 50 cm"), LOW_MARGIN),
        measure("old", "stable over the marker after", "s", stable, about(4.5, "about 4.5 s"), LOW_MARGIN),
        leaves("old", LOW_MARGIN, false),
        measure(
            "new",
            "overshoot",
            "cm",
            overshoot,
            Claim::AtMost(9.85, "small, within the marker"),
            SOME_MARGIN,
        ),
        measure("new", "stable over the marker after", "s", stable, about(2.0, "about 2 s"), SOME_MARGIN),
        leaves("new", SOME_MARGIN, false),
    ];
    lines(model, ("7.3, fig. 7.4-7.8", "80 cm to the marker"), ("fly-80cm", VerticalInput::Pwm), &measures)
}

const FIRST_ORDER: &str = "5.4 is first order: it has no inertia that could carry the vehicle over";
const SWINGS: &str = "5.4 has no inertia; through the camera the old gains swing sideways too, and the tilt enters the height error";
const PRESET: &str = "the ramp hands over a thrust above the weight for the integral to unwind; the heave damping is not in the thesis";

fn takeoff_measures(old: &'static str, new: &'static str) -> [Measure; 6] {
    let overshoot: fn(&Trace) -> f64 = |t| 100.0 * beyond(&in_the_air(t), 0.0, 0.7);
    let swing: fn(&Trace) -> f64 = |t| 100.0 * swing_after_peak(&in_the_air(t), 0.7);
    let stable: fn(&Trace) -> f64 = |t| stable_s(&in_the_air(t), 0.7, BAND_M, t.tick_s);
    let measure = |gains: &'static str, quantity, unit, quantity_of, claim| Measure {
        gains,
        quantity,
        unit,
        decimals: 1,
        quantity_of,
        claim,
        aggregate: middle,
        quiet: false,
        why: if gains == "old" { old } else { new },
    };
    [
        measure("old", "overshoot", "cm", overshoot, about(25.0, "almost 25 cm")),
        measure("old", "fluctuation after it", "cm", swing, about(10.0, "10 cm")),
        measure("old", "stable after lift-off", "s", stable, about(7.0, "about 7 s")),
        measure("new", "overshoot", "cm", overshoot, Claim::Words("remains, no figure")),
        measure("new", "fluctuation after it", "cm", swing, Claim::AtMost(5.0, "none")),
        measure("new", "stable after lift-off", "s", stable, about(3.0, "about 3 s")),
    ]
}

/// Figure 7.9 on the form that the thesis identified.
fn takeoff(model: &Model) -> Result<Vec<ScorecardRow>, Error> {
    let measures = takeoff_measures(SWINGS, FIRST_ORDER);
    lines(
        model,
        ("7.3, fig. 7.9", "take-off to 70 cm, on 5.4"),
        ("takeoff-70cm", VerticalInput::Pwm),
        &measures,
    )
}

/// Figure 7.9 on the acceleration form.
fn takeoff_by_thrust(model: &Model) -> Result<Vec<ScorecardRow>, Error> {
    let measures = takeoff_measures(PRESET, PRESET);
    lines(
        model,
        ("7.3, fig. 7.9", "take-off to 70 cm, thrust form"),
        ("takeoff-70cm", VerticalInput::Thrust),
        &measures,
    )
}

const CYCLE: &str =
    "with this delay the old gains are unstable on 5.1 and 5.5: the swing grows until the room ends";
const CALM: &str =
    "the new gains have half the derivative gain: through a noisy camera they are the calmer ones";

/// Figures 7.10 to 7.14.
fn hover(model: &Model) -> Result<Vec<ScorecardRow>, Error> {
    let off: fn(&Trace) -> f64 = |t| {
        let squares = t.rows.iter().map(|r| {
            f64::from(r.state[state_index::POS]).powi(2) + f64::from(r.state[state_index::POS + 1]).powi(2)
        });
        100.0 * (squares.sum::<f64>() / t.rows.len() as f64).sqrt()
    };
    let travel: fn(&Trace) -> f64 = |t| {
        let pitch: Vec<f64> =
            (0..t.rows.len()).filter_map(|row| t.command(row)).map(|u| u.pitch_rad.to_degrees()).collect();
        pitch.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum::<f64>() / (pitch.len() as f64 * t.tick_s)
    };
    let measure = |gains, quantity, unit, quantity_of, claim, why| Measure {
        gains,
        quantity,
        unit,
        decimals: 1,
        quantity_of,
        claim,
        aggregate: middle,
        quiet: true,
        why,
    };
    let measures = [
        measure(
            "old",
            "distance from the centre, RMS",
            "cm",
            off,
            Claim::Words("\"quite good\", small overshoot"),
            CYCLE,
        ),
        measure("old", "travel of the pitch command", "deg/s", travel, Claim::Words("smooth"), CYCLE),
        leaves("old", CYCLE, true),
        measure("new", "distance from the centre, RMS", "cm", off, Claim::Words("more accurate"), ""),
        measure("new", "travel of the pitch command", "deg/s", travel, Claim::Words("brusquer"), CALM),
        leaves("new", "", true),
    ];
    lines(model, ("7.3, fig. 7.10-7.14", "hover at 70 cm"), ("hover-70cm", VerticalInput::Pwm), &measures)
}

/// Overshoot of values beyond the target, coming from `start`.
fn beyond(values: &[f64], start: f64, target: f64) -> f64 {
    let towards = (target - start).signum();
    values.iter().map(|v| towards * (v - target)).fold(0.0, f64::max)
}

/// Largest deviation after the first peak, once it is over: from the return to the target on.
fn swing_after_peak(values: &[f64], target: f64) -> f64 {
    let above = values.iter().position(|v| *v > target).unwrap_or(values.len());
    let back = values[above..].iter().position(|v| *v <= target).map_or(values.len(), |i| above + i);
    values[back..].iter().map(|v| (v - target).abs()).fold(0.0, f64::max)
}

/// Seconds until the values stay within the band for good; infinite if they never do.
fn stable_s(values: &[f64], target: f64, band: f64, tick_s: f64) -> f64 {
    match values.iter().rposition(|v| (v - target).abs() > band) {
        None => 0.0,
        Some(last) if last + 1 == values.len() => f64::INFINITY,
        Some(last) => (last + 1) as f64 * tick_s,
    }
}

/// The height from lift-off on.
fn in_the_air(trace: &Trace) -> Vec<f64> {
    let z = trace.state(2);
    let first = z.iter().position(|z| *z > 0.01).unwrap_or(0);
    z[first..].to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_a_known_curve() {
        let z = [0.0, 0.5, 0.9, 0.7, 0.6, 0.72, 0.7];
        assert!((beyond(&z, 0.0, 0.7) - 0.2).abs() < 1e-12);
        assert!((swing_after_peak(&z, 0.7) - 0.1).abs() < 1e-12);
        assert_eq!(stable_s(&z, 0.7, 0.05, 1.0), 5.0);
        assert_eq!(stable_s(&z[..3], 0.7, 0.05, 1.0), f64::INFINITY);
        assert_eq!(swing_after_peak(&[0.0, 0.5], 0.7), 0.0);
    }
}
