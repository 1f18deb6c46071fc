//! Constants of the vehicle that effects act on.

use super::{Accelerations, Command, State};
use crate::scalar::Scalar;

/// Constants of the vehicle that effects need.
#[derive(Debug, Clone, Copy)]
pub struct VehicleConstants<R> {
    /// Magnitude of the gravitational acceleration.
    pub gravity_mps2: R,
    /// Mass of the vehicle as it flies, battery and camera included.
    pub mass_kg: R,
    /// Radius of one propeller.
    pub rotor_radius_m: R,
    /// 1 / (charge of the full battery in coulombs).
    pub per_battery_capacity_pc: R,
    /// Battery current of a hover.
    pub hover_current_a: R,
    /// Voltage at which the model's thrust is valid.
    pub battery_reference_v: R,
    /// 1 / (PWM that carries the weight); zero where the command is a height.
    pub per_hover_pwm: R,
    /// 1 where the command is a height (then the thrust is taken as the weight), 0 where it is a PWM.
    pub height_command: R,
    /// Centre to motor.
    pub arm_m: R,
    /// Vertical damping per mass, where the model has it.
    pub heave_ps: R,
    /// +1 or -1: the sign with which a commanded yaw rate turns the vehicle.
    pub yaw_sign: R,
    /// Yaw dynamics: angle'' = gain command - damping angle' - stiffness angle. An integrator (5.2) represents a rate
    /// loop with the damping with which a push on it dies away.
    pub yaw_gain_ps2: R,
    /// Damping of the yaw dynamics, of the form above.
    pub yaw_damping_ps: R,
    /// Stiffness of the yaw dynamics, of the form above.
    pub yaw_stiffness_ps2: R,
    /// Roll and pitch dynamics (5.1): angle'' = gain command - damping angle' - stiffness angle.
    pub tilt_gain_ps2: [R; 2],
    /// Damping of the tilt dynamics of the form above: roll, pitch.
    pub tilt_damping_ps: [R; 2],
    /// Stiffness of the tilt dynamics of the form above: roll, pitch.
    pub tilt_stiffness_ps2: [R; 2],
}

impl<R: Scalar> VehicleConstants<R> {
    /// All of them, for derivatives of each.
    pub(crate) fn numbers(&mut self) -> impl Iterator<Item = &mut R> {
        let tilts = [&mut self.tilt_gain_ps2, &mut self.tilt_damping_ps, &mut self.tilt_stiffness_ps2];
        let others = [
            &mut self.gravity_mps2,
            &mut self.mass_kg,
            &mut self.rotor_radius_m,
            &mut self.per_battery_capacity_pc,
            &mut self.hover_current_a,
            &mut self.battery_reference_v,
            &mut self.per_hover_pwm,
            &mut self.height_command,
            &mut self.arm_m,
            &mut self.heave_ps,
            &mut self.yaw_sign,
            &mut self.yaw_gain_ps2,
            &mut self.yaw_damping_ps,
            &mut self.yaw_stiffness_ps2,
        ];
        tilts.into_iter().flatten().chain(others)
    }
    /// Thrust over weight.
    #[inline(always)]
    pub fn thrust_ratio(&self, u: &Command<R>) -> R {
        self.height_command + u.lift * self.per_hover_pwm
    }
    /// Returns the command that keeps roll (axis 0) or pitch (1) at a tilt: gain command = stiffness tilt in 5.1.
    #[inline(always)]
    pub fn command_for_tilt_rad(&self, axis: usize, tilt_rad: R) -> R {
        tilt_rad * self.tilt_stiffness_ps2[axis] / self.tilt_gain_ps2[axis]
    }
    /// Angular acceleration of roll and pitch by the declared attitude dynamics (5.1).
    #[inline(always)]
    pub fn tilt_torque_radps2(&self, x: &State<R>, u: &Command<R>) -> [R; 2] {
        let asked = |i: usize, command: R| {
            self.tilt_gain_ps2[i] * command
                - self.tilt_damping_ps[i] * x.rate_radps[i]
                - self.tilt_stiffness_ps2[i] * x.att_rad[i]
        };
        [asked(0, u.roll_rad), asked(1, u.pitch_rad)]
    }
    /// Angular acceleration of yaw by the declared dynamics.
    #[inline(always)]
    pub fn yaw_torque_radps2(&self, x: &State<R>, u: &Command<R>) -> R {
        self.yaw_gain_ps2 * u.yaw_rate_radps
            - self.yaw_damping_ps * x.rate_radps[2]
            - self.yaw_stiffness_ps2 * x.att_rad[2]
    }
    /// Add this share `more` of the declared torques, see [`VehicleConstants::add_torques`].
    #[inline(always)]
    pub fn add_torque(&self, more: R, h_s: f64, x: &State<R>, u: &Command<R>, out: &mut Accelerations<R>) {
        // most effects of thrust leave the torques alone
        if more.is_zero() {
            return;
        }
        self.add_torques([more; 3], h_s, x, u, out);
    }
    /// Add these shares `more` of the declared torques of roll, pitch and yaw. They are taken at the middle of a
    /// physics step of `h_s`: the state expected there has the rates of the step's start, which the damping of 5.1
    /// (28.8 1/s) changes by a quarter within 10 ms.
    #[inline(always)]
    pub fn add_torques(
        &self,
        more: [R; 3],
        h_s: f64,
        x: &State<R>,
        u: &Command<R>,
        out: &mut Accelerations<R>,
    ) {
        let [roll, pitch] = self.tilt_torque_radps2(x, u);
        let at_start = [roll, pitch, self.yaw_torque_radps2(x, u)];
        let damping_ps = [self.tilt_damping_ps[0], self.tilt_damping_ps[1], self.yaw_damping_ps];
        for i in 0..3 {
            let slowed =
                R::from_f64(1.0) + R::from_f64(0.5 * h_s) * damping_ps[i] * (R::from_f64(1.0) + more[i]);
            out.ang_radps2[i] += more[i] * at_start[i] / slowed;
        }
    }
    /// Returns the thrust per mass, scaled by the effects before: `out` has no other upward part when those of the
    /// thrust are called.
    #[inline(always)]
    pub fn thrust_mps2(&self, u: &Command<R>, out: &Accelerations<R>) -> R {
        self.gravity_mps2 * self.thrust_ratio(u) + out.acc_mps2[2]
    }
}
