//! The position controller of the Crazyflie's firmware (`position_controller_pid.c`, default gains of the Crazyflie
//! 2.x platform): a loop on position commands a velocity, a loop on that tilt and thrust. On NanoBench's flights a
//! regression of the logged commands on position error and velocity gives 49 to 50 deg/m and -24.5 deg/(m/s), which
//! agrees with these gains (2 x 25 and 25).

use crazyflie_env::model::FULL_PWM;
use crazyflie_env::observation::Setpoint;
use crazyflie_env::plant::{Command, State};
use crazyflie_env::scalar::wrap;

/// kp, ki and the largest output of a loop.
struct Gains(f64, f64, f64);

/// Horizontal and vertical: m/s per metre, limited to 1.1 m/s.
const POSITION: Gains = Gains(2.0, 0.0, 1.1);
const HEIGHT: Gains = Gains(2.0, 0.5, 1.1);
/// Degrees per m/s; the output's limit is 20 degrees and a tenth more.
const VELOCITY: Gains = Gains(25.0, 1.0, 22.0);
/// Thrust in thousands of PWM per m/s, limited to half the range.
const CLIMB: Gains = Gains(25.0, 15.0, 32.767);
const TILT_MAX_DEG: f64 = 20.0;
const THRUST_SCALE: f64 = 1000.0;
const THRUST_BASE_PWM: f64 = 36_000.0;
const THRUST_RANGE_PWM: [f64; 2] = [20_000.0, FULL_PWM];
/// Gain of the attitude loop, deg/s per degree.
const YAW_KP: f64 = 6.0;

#[derive(Debug, Default)]
struct PiLoop {
    integral: f64,
}

impl PiLoop {
    fn update(&mut self, &Gains(kp, ki, limit): &Gains, error: f64, dt_s: f64) -> f64 {
        self.integral += error * dt_s;
        (kp * error + ki * self.integral).clamp(-limit, limit)
    }
}

/// One vehicle's controller.
#[derive(Debug, Default)]
pub(super) struct FirmwareCascade {
    dt_s: f64,
    yaw_sign: f64,
    position: [PiLoop; 2],
    velocity: [PiLoop; 2],
    height: PiLoop,
    climb: PiLoop,
}

impl FirmwareCascade {
    /// Called every `dt_s` seconds, on a vehicle that hovers at `hover_pwm`: in flight, the thrust integral
    /// carries the rest of the weight.
    pub(super) fn new(dt_s: f64, hover_pwm: f64, yaw_sign: f64) -> Self {
        let climb = PiLoop { integral: (hover_pwm - THRUST_BASE_PWM) / THRUST_SCALE / CLIMB.1 };
        FirmwareCascade { dt_s, yaw_sign, climb, ..FirmwareCascade::default() }
    }

    /// The command at a state, which the vehicle's estimator is taken to know.
    pub(super) fn command(&mut self, x: &State<f64>, target: &Setpoint<f64>) -> Command<f64> {
        let (sin, cos) = x.att_rad[2].sin_cos();
        let body = |v: [f64; 2]| [cos * v[0] + sin * v[1], cos * v[1] - sin * v[0]];
        let error = body([target.pos_m[0] - x.pos_m[0], target.pos_m[1] - x.pos_m[1]]);
        let speed = body([x.vel_mps[0], x.vel_mps[1]]);
        let dt_s = self.dt_s;
        let mut tilt_deg = |i: usize| {
            let wanted = self.position[i].update(&POSITION, error[i], dt_s);
            self.velocity[i].update(&VELOCITY, wanted - speed[i], dt_s).clamp(-TILT_MAX_DEG, TILT_MAX_DEG)
        };
        let (pitch_deg, roll_deg) = (tilt_deg(0), -tilt_deg(1));
        let climb = self.height.update(&HEIGHT, target.pos_m[2] - x.pos_m[2], dt_s);
        let thrust = self.climb.update(&CLIMB, climb - x.vel_mps[2], dt_s);
        let lift = (THRUST_BASE_PWM + THRUST_SCALE * thrust).clamp(THRUST_RANGE_PWM[0], THRUST_RANGE_PWM[1]);
        let yaw_rate_radps = self.yaw_sign * YAW_KP * wrap(target.yaw_rad - x.att_rad[2]);
        Command { roll_rad: roll_deg.to_radians(), pitch_rad: pitch_deg.to_radians(), yaw_rate_radps, lift }
    }
}
