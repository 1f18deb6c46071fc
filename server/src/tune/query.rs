//! Requests of the page's tuner: a loop on paper and a thousand flights of the simulator, for some gains.

use crazyflie_control::loop_analysis::{FeedbackLoop, LoopAxis, LoopReport, dead_time_s};
use crazyflie_control::pid::{Gains, Loop};
use crazyflie_env::error::{Error, Result, check_range};
use crazyflie_env::model::{Model, VerticalInput};
use serde::{Deserialize, Serialize};

use super::hovering_gains;
use crate::flight::{StepBand, fly_band, sensor_rig, step_setup};

/// Flights of one answer at most.
pub const MOST_FLIGHTS: usize = 1000;
/// Gains beyond this are refused: no loop of the vehicle flies a thousandth of it.
const LARGEST_GAIN: f64 = 1e6;

/// Gains of one loop; what is left out is table 7.1's.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TunerQuery {
    /// x, y, z or yaw.
    #[serde(rename = "loop")]
    pub axis: String,
    /// A vehicle's name; the thesis's unless given.
    pub vehicle: Option<String>,
    /// Vertical form of the model; the thrust form, which has inertia, unless given.
    pub vertical: Option<VerticalInput>,
    /// ideal or lab, as in `crazyflie fly`.
    pub sensors: Option<String>,
    /// Proportional gain.
    pub kp: Option<f64>,
    /// Integral gain.
    pub ki: Option<f64>,
    /// Derivative gain.
    pub kd: Option<f64>,
    /// Number of flights, up to [`MOST_FLIGHTS`].
    pub flights: Option<usize>,
}

/// A loop on paper and in flight.
#[derive(Debug, Clone, Serialize)]
pub struct TunerAnswer {
    /// Gains that the search begins with on this form: table 7.1's.
    pub table_7_1: Loop,
    /// Margins, step response, frequency response and poles.
    pub report: LoopReport,
    /// The flights.
    pub band: StepBand,
}

impl TunerQuery {
    /// The vehicle with these gains.
    ///
    /// # Errors
    /// For unknown names, and gains or numbers of flights that are out of range.
    pub fn answer(&self) -> Result<TunerAnswer> {
        let model = self.vehicle.as_deref().map_or_else(|| Ok(Model::thesis()), Model::parse)?;
        let axis = LoopAxis::find(&self.axis)?;
        let vertical = self.vertical.unwrap_or(VerticalInput::Thrust);
        if axis == LoopAxis::Z && !vertical.is_pwm() {
            return Err(Error::Config("the height form needs no height loop; choose pwm or thrust".into()));
        }
        let (effects, latency_s) = sensor_rig(self.sensors.as_deref().unwrap_or("lab"))?;
        let flights = self.flights.unwrap_or(MOST_FLIGHTS);
        check_range("flights", flights as f64, 1.0, MOST_FLIGHTS as f64)?;
        let table = hovering_gains(&model, vertical, &Gains::THESIS)?;
        let own = *axis.gains(&table);
        for (name, gain) in [("kp", self.kp), ("ki", self.ki), ("kd", self.kd)] {
            check_range(name, gain.unwrap_or(0.0), -LARGEST_GAIN, LARGEST_GAIN)?;
        }
        let asked = Loop {
            kp: self.kp.unwrap_or(own.kp),
            ki: self.ki.unwrap_or(own.ki),
            kd: self.kd.unwrap_or(own.kd),
            ..own
        };
        let gains = axis.with_gains(&table, asked);
        let dead_time_s = dead_time_s(&model, latency_s);
        let feedback = FeedbackLoop::from_model(&model, vertical, axis, &gains, dead_time_s)?;
        let seeds: Vec<u64> = (0..flights as u64).collect();
        let band = fly_band(&step_setup(&model, vertical, effects, &gains, axis)?, &seeds, axis)?;
        Ok(TunerAnswer {
            table_7_1: own,
            report: feedback.report(axis.name(), 1.0 / model.rig.control.value),
            band,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn query(text: &str) -> TunerQuery {
        serde_json::from_str(text).unwrap()
    }

    /// On the thrust form the height loop of table 7.1 is stable at 6 times its Kp, not at 10 times. In flight the
    /// limits of the thrust bound the growth: it keeps oscillating while table 7.1 settles.
    #[test]
    fn what_is_unstable_on_paper_goes_on_swinging_in_flight() {
        let good = query(r#"{"loop": "z", "flights": 32}"#).answer().unwrap();
        let bad = query(r#"{"loop": "z", "flights": 32, "kp": 107819}"#).answer().unwrap();
        assert!(good.report.margins.phase_deg > 0.0 && good.band.crashed == 0, "{:?}", good.report.margins);
        assert!(bad.report.margins.phase_deg < 0.0, "{:?}", bad.report.margins);
        // swing of the median over the last two seconds
        let swing_m = |answer: &TunerAnswer| {
            let median = &answer.band.quantiles[2];
            let late = &median[median.len() - 100..];
            let [low, high] = [
                late.iter().copied().fold(f32::MAX, f32::min),
                late.iter().copied().fold(f32::MIN, f32::max),
            ];
            high - low
        };
        let (good_m, bad_m) = (swing_m(&good), swing_m(&bad));
        println!("swing of the last two seconds: {good_m:.2} m with table 7.1, {bad_m:.2} m");
        assert!(bad_m > 2.0 * good_m, "{bad_m} {good_m}");
    }

    #[test]
    fn a_band_is_in_order_and_follows_the_set_point() {
        for axis in LoopAxis::ALL {
            let asked = TunerQuery { axis: axis.name().into(), ..query(r#"{"loop": "x", "flights": 20}"#) };
            let band = asked.answer().unwrap().band;
            assert_eq!(band.t_s.len(), band.target.len());
            for lines in band.quantiles.windows(2) {
                assert!(lines[0].iter().zip(&lines[1]).all(|(low, high)| low <= high), "{axis:?}");
            }
            assert!(band.target.first() < band.target.last(), "{axis:?}");
        }
    }

    #[test]
    fn bad_questions_get_an_answer_in_words() {
        for (text, words) in [
            (r#"{"loop": "zz"}"#, "did you mean"),
            (r#"{"loop": "z", "vertical": "height"}"#, "pwm or thrust"),
            (r#"{"loop": "x", "sensors": "labs"}"#, "\"lab\""),
            (r#"{"loop": "x", "flights": 0}"#, "flights"),
            (r#"{"loop": "x", "flights": 1001}"#, "1000"),
            (r#"{"loop": "x", "kp": 1e9}"#, "kp"),
        ] {
            let error = query(text).answer().unwrap_err().to_string();
            assert!(error.contains(words), "{text}: {error}");
        }
        let nan = TunerQuery { kd: Some(f64::NAN), ..query(r#"{"loop": "x"}"#) };
        assert!(nan.answer().unwrap_err().to_string().contains("kd"));
    }
}
