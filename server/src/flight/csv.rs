//! A flight as a log, which the project's CSV is written from.

use crazyflie_env::observation::{MARKER_POS, index};
use crazyflie_env::plant::Command;
use crazyflie_logs::{AttitudeSource, Fixes, FlightLog, PositionSource, Provenance, Truth};

use super::Trace;

/// Capture times are known to the rounding of a 32-bit clock.
const ROUNDING_S: f64 = 1e-5;

/// Returns the log of a recorder beside the controller, and the truth. Marker fixes are in the rows at which a new
/// frame arrived. If actions are set-points, there are no commands.
pub fn log(trace: &Trace) -> FlightLog {
    let rows = 0..trace.rows.len();
    let commands: Option<Vec<Command<f64>>> = rows.clone().map(|row| trace.command(row)).collect();
    let command = |number: fn(&Command<f64>) -> f64| {
        commands.as_ref().map(|commands| commands.iter().map(number).collect::<Vec<f64>>())
    };
    let lift = |pwm: bool| command(|u| u.lift).filter(|_| trace.interface.input.is_pwm() == pwm);
    let triple = |first: usize| [0, 1, 2].map(|i| trace.observation_column(first + i));
    let truth = |first: usize| [0, 1, 2].map(|i| trace.state(first + i));
    let [roll_rad, pitch_rad, yaw_rad] = triple(6);
    let [true_roll, true_pitch, true_yaw] = truth(6);
    FlightLog {
        provenance: Provenance {
            format: "simulated",
            position: PositionSource::Camera,
            attitude: AttitudeSource::Imu,
            onboard_interpolated: false,
        },
        t_s: rows.clone().map(|row| trace.t_s(row)).collect(),
        airborne: rows,
        cmd_roll_rad: command(|u| u.roll_rad),
        cmd_pitch_rad: command(|u| u.pitch_rad),
        cmd_yaw_rate_radps: command(|u| u.yaw_rate_radps),
        cmd_thrust_pwm: lift(true),
        cmd_height_m: lift(false),
        setpoint_m: Some(triple(16)),
        setpoint_yaw_rad: Some(trace.observation_column(19)),
        fixes: fixes(trace),
        vel_mps: None,
        roll_rad,
        pitch_rad,
        yaw_rad,
        gyro_radps: Some(triple(9)),
        acc_mps2: Some(triple(12)),
        vbat_v: Some(trace.observation_column(15)),
        onboard: None,
        truth: Some(Truth {
            pos_m: truth(0),
            vel_mps: truth(3),
            roll_rad: true_roll,
            pitch_rad: true_pitch,
            yaw_rad: true_yaw,
        }),
        notes: Vec::new(),
    }
}

fn fixes(trace: &Trace) -> Fixes {
    let mut fixes = Fixes { yaw_rad: Some(Vec::new()), ..Fixes::default() };
    let mut newest_s = f64::NEG_INFINITY;
    for (i, row) in trace.rows.iter().enumerate() {
        let o = row.observation.map(f64::from);
        let captured_s =
            (((trace.t_s(i) - o[index::MARKER_AGE]) / ROUNDING_S).round() * ROUNDING_S).min(trace.t_s(i));
        if captured_s < newest_s + 10.0 * ROUNDING_S {
            continue;
        }
        newest_s = captured_s;
        fixes.row.push(i);
        fixes.capture_t_s.push(captured_s);
        fixes.pos_m.iter_mut().zip(&o[MARKER_POS.range()]).for_each(|(list, value)| list.push(*value));
        fixes.yaw_rad.iter_mut().for_each(|list| list.push(o[index::MARKER_YAW]));
    }
    fixes
}
