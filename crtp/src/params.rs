//! The parameters, declared once: table of contents, defaults, documentation and what they change follow.

use crazyflie_env::action::CascadeGains;
use crazyflie_env::error::find_named;

use crate::values::Kind;
use crate::values::Kind::{F32, U8, U16, U32};

/// A parameter.
#[derive(Debug, Clone, Copy)]
pub struct Param {
    /// Group and name with a point between.
    pub name: &'static str,
    /// Kind of its number.
    pub kind: Kind,
    /// True if clients can only read it.
    pub read_only: bool,
    /// True if its value may be stored and then survives a restart.
    pub persistent: bool,
    /// Value after a start.
    pub default: f64,
    /// Symbol of the unit; "1" for a pure number.
    pub unit: &'static str,
    /// Description for users, without a full stop.
    pub about: &'static str,
}

const fn param(
    name: &'static str,
    kind: Kind,
    default: f64,
    unit: &'static str,
    about: &'static str,
) -> Param {
    Param { name, kind, read_only: false, persistent: true, default, unit, about }
}

const fn fixed(name: &'static str, kind: Kind, default: f64, about: &'static str) -> Param {
    Param { name, kind, read_only: true, persistent: false, default, unit: "1", about }
}

/// An order: writing 1 does something once.
const fn order(name: &'static str, about: &'static str) -> Param {
    Param { name, kind: U8, read_only: false, persistent: false, default: 0.0, unit: "1", about }
}

/// Descriptions of parameters that stock scripts write and that have no counterpart here, and of others.
const KEPT: &str = "kept for scripts, changes nothing: the model has these loops identified";
const NO_PART: &str = "kept for scripts, changes nothing: the simulated loop has no such part";
const ONE_ESTIMATOR: &str = "kept for scripts: the estimator is a Kalman filter whatever it says";
const ONE_CONTROLLER: &str = "kept for scripts: the controller is the PID cascade whatever it says";
const POSITION_NOISE: &str = "standard deviation that the filter gives external positions";
const HEADING_NOISE: &str = "standard deviation that the filter gives external headings";
const HOVER_THRUST: &str = "thrust without error: the default is the model's own hover";
const LARGEST_TILT: &str = "largest tilt of the position loops; the model's limit holds as well";

/// Every parameter, in the order of the table of contents.
pub static PARAMS: &[Param] = &[
    param("commander.enHighLevel", U8, 1.0, "1", "0 ignores the high-level commander"),
    param("hlCommander.vtoff", F32, 0.5, "m/s", "mean speed of a take-off that names no duration"),
    param("hlCommander.vland", F32, 0.5, "m/s", "mean speed of a landing that names no duration"),
    param("flightmode.althold", U8, 0.0, "1", NO_PART),
    param("flightmode.poshold", U8, 0.0, "1", NO_PART),
    param("flightmode.yawMode", U8, 1.0, "1", NO_PART),
    param("flightmode.stabModeRoll", U8, 1.0, "1", NO_PART),
    param("flightmode.stabModePitch", U8, 1.0, "1", NO_PART),
    param("flightmode.stabModeYaw", U8, 0.0, "1", NO_PART),
    param("stabilizer.estimator", U8, 2.0, "1", ONE_ESTIMATOR),
    param("stabilizer.controller", U8, 1.0, "1", ONE_CONTROLLER),
    order("sim.reset", "1 puts all drones back on their places, upright and unlocked"),
    order("stabilizer.stop", "1 is an emergency stop"),
    order("kalman.resetEstimation", "1 lets the position filter begin again"),
    param("kalman.initialX", F32, 0.0, "m", "where the filter begins after a reset"),
    param("kalman.initialY", F32, 0.0, "m", "where the filter begins after a reset"),
    param("kalman.initialZ", F32, 0.0, "m", "where the filter begins after a reset"),
    param("kalman.initialYaw", F32, 0.0, "rad", "where the filter begins after a reset"),
    param("kalman.pNAcc_xy", F32, 0.5, "m/s^2", "acceleration sideways that the filter does not know"),
    param("kalman.pNAcc_z", F32, 1.0, "m/s^2", "acceleration upwards that the filter does not know"),
    param("locSrv.extPosStdDev", F32, 0.01, "m", POSITION_NOISE),
    param("locSrv.extQuatStdDev", F32, 0.0045, "rad", HEADING_NOISE),
    param("posCtlPid.xKp", F32, 2.0, "1/s", "velocity asked for per metre of error"),
    param("posCtlPid.xKi", F32, 0.0, "1/s^2", NO_PART),
    param("posCtlPid.xKd", F32, 0.0, "1", NO_PART),
    param("posCtlPid.yKp", F32, 2.0, "1/s", "velocity asked for per metre of error"),
    param("posCtlPid.yKi", F32, 0.0, "1/s^2", NO_PART),
    param("posCtlPid.yKd", F32, 0.0, "1", NO_PART),
    param("posCtlPid.zKp", F32, 2.0, "1/s", "climb rate asked for per metre of error"),
    param("posCtlPid.zKi", F32, 0.5, "1/s^2", "climb rate asked for per metre and second of error"),
    param("posCtlPid.zKd", F32, 0.0, "1", NO_PART),
    param("posCtlPid.thrustBase", U16, 36000.0, "1", HOVER_THRUST),
    param("posCtlPid.thrustMin", U16, 20000.0, "1", "least thrust of the position loops"),
    param("posCtlPid.rpLimit", F32, 20.0, "deg", LARGEST_TILT),
    param("posCtlPid.xVelMax", F32, 1.0, "m/s", "most that the position loop asks for"),
    param("posCtlPid.yVelMax", F32, 1.0, "m/s", "most that the position loop asks for"),
    param("posCtlPid.zVelMax", F32, 1.0, "m/s", "most that the position loop asks for"),
    param("velCtlPid.vxKp", F32, 25.0, "deg s/m", "tilt per velocity error along the nose"),
    param("velCtlPid.vxKi", F32, 1.0, "deg/m", "tilt per metre that the error adds up to"),
    param("velCtlPid.vxKd", F32, 0.0, "1", NO_PART),
    param("velCtlPid.vyKp", F32, 25.0, "deg s/m", "tilt per velocity error to the left"),
    param("velCtlPid.vyKi", F32, 1.0, "deg/m", "tilt per metre that the error adds up to"),
    param("velCtlPid.vyKd", F32, 0.0, "1", NO_PART),
    param("velCtlPid.vzKp", F32, 25.0, "1000 s/m", "thrust per velocity error upwards"),
    param("velCtlPid.vzKi", F32, 15.0, "1000/m", "thrust per metre that the error adds up to"),
    param("velCtlPid.vzKd", F32, 0.0, "1", NO_PART),
    param("pid_attitude.roll_kp", F32, 6.0, "1", KEPT),
    param("pid_attitude.roll_ki", F32, 3.0, "1", KEPT),
    param("pid_attitude.roll_kd", F32, 0.0, "1", KEPT),
    param("pid_attitude.pitch_kp", F32, 6.0, "1", KEPT),
    param("pid_attitude.pitch_ki", F32, 3.0, "1", KEPT),
    param("pid_attitude.pitch_kd", F32, 0.0, "1", KEPT),
    param("pid_attitude.yaw_kp", F32, 6.0, "1/s", "yaw rate asked for per radian of error"),
    param("pid_attitude.yaw_ki", F32, 1.0, "1", KEPT),
    param("pid_attitude.yaw_kd", F32, 0.35, "1", KEPT),
    param("pid_rate.roll_kp", F32, 250.0, "1", KEPT),
    param("pid_rate.roll_ki", F32, 500.0, "1", KEPT),
    param("pid_rate.roll_kd", F32, 2.5, "1", KEPT),
    param("pid_rate.pitch_kp", F32, 250.0, "1", KEPT),
    param("pid_rate.pitch_ki", F32, 500.0, "1", KEPT),
    param("pid_rate.pitch_kd", F32, 2.5, "1", KEPT),
    param("pid_rate.yaw_kp", F32, 120.0, "1", KEPT),
    param("pid_rate.yaw_ki", F32, 16.7, "1", KEPT),
    param("pid_rate.yaw_kd", F32, 0.0, "1", KEPT),
    param("pm.lowVoltage", F32, 3.2, "V", "below it for a second, `pm.state` is 3"),
    param("pm.criticalLowVoltage", F32, 3.0, "V", "below it for five seconds, the motors stop for good"),
    param("supervisor.tmblChckEn", U8, 1.0, "1", "0 lets a tumbled vehicle go on"),
    param("led.bitmask", U8, 0.0, "1", NO_PART),
    param("ring.effect", U8, 0.0, "1", NO_PART),
    param("sound.effect", U8, 0.0, "1", NO_PART),
    fixed("deck.bcFlow2", U8, 0.0, "whether a Flow deck is on, see `cf2 --deck`"),
    fixed("deck.bcLighthouse4", U8, 0.0, "whether a Lighthouse deck is on: with `cf2 --position lighthouse`"),
    fixed("deck.bcZRanger2", U8, 0.0, "whether a Z-ranger is on, see `cf2 --deck`"),
    fixed("deck.bcMultiranger", U8, 0.0, "whether a Multi-ranger is on, see `cf2 --deck`"),
    fixed("deck.bcDWM1000", U8, 0.0, "whether a Loco deck is on, see `cf2 --deck`"),
    fixed("deck.bcLedRing", U8, 0.0, "whether a LED ring is on, see `cf2 --deck`"),
    fixed("system.selftestPassed", U8, 1.0, "the self-test: passed"),
    fixed("imu_sensors.BMP3XX", U8, 1.0, "the barometer's self-test: passed"),
    fixed("cpu.flash", U16, 1024.0, "kilobytes of flash"),
    fixed("cpu.id0", U32, 0.0, "serial number: the drone's index"),
    fixed("firmware.revision0", U32, 0.0, "no firmware: the simulator"),
    fixed("firmware.revision1", U16, 0.0, "no firmware: the simulator"),
    fixed("firmware.modified", U8, 1.0, "no firmware: the simulator"),
];

/// Values of all parameters.
#[derive(Debug, Clone)]
pub(crate) struct ParamValues(Vec<f64>);

/// The parameter of a deck.
///
/// # Errors
/// [`crazyflie_env::Error::Unknown`] with a proposal.
pub fn deck(name: &str) -> crazyflie_env::Result<&'static str> {
    let all = PARAMS.iter().filter_map(|param| Some((param.name, param.name.strip_prefix("deck.")?)));
    find_named("deck", name, all, |(_, deck)| deck).map(|(param, _)| param)
}

impl ParamValues {
    pub(crate) fn new() -> Self {
        ParamValues(PARAMS.iter().map(|param| param.default).collect())
    }

    pub(crate) fn value(&self, id: usize) -> f64 {
        self.0[id]
    }

    pub(crate) fn set_value(&mut self, id: usize, value: f64) {
        self.0[id] = value;
    }

    /// The value of a parameter that there is: tests name them all.
    pub(crate) fn get(&self, name: &str) -> f64 {
        index(name).map_or(0.0, |id| self.0[id])
    }

    pub(crate) fn set(&mut self, name: &str, value: f64) {
        if let Some(id) = index(name) {
            self.0[id] = value;
        }
    }

    /// Gains of the cascade as written; what cannot be one (negative, no number) counts as nothing.
    pub(crate) fn gains(&self) -> CascadeGains {
        let of = |name: &str| {
            let value = self.get(name);
            if value.is_finite() { value.clamp(0.0, 1e6) } else { 0.0 }
        };
        CascadeGains {
            position_ps: [of("posCtlPid.xKp"), of("posCtlPid.yKp"), of("posCtlPid.zKp")],
            height_integral_ps2: of("posCtlPid.zKi").max(SMALL),
            speed_max_mps: [of("posCtlPid.xVelMax"), of("posCtlPid.yVelMax"), of("posCtlPid.zVelMax")],
            tilt_deg_per_mps: [of("velCtlPid.vxKp"), of("velCtlPid.vyKp")],
            tilt_deg_per_m: [of("velCtlPid.vxKi").max(SMALL), of("velCtlPid.vyKi").max(SMALL)],
            tilt_max_deg: of("posCtlPid.rpLimit"),
            // the firmware's own scale (`thrustScale`)
            thrust_per_mps: 1000.0 * of("velCtlPid.vzKp").max(SMALL),
            thrust_per_m: 1000.0 * of("velCtlPid.vzKi").max(SMALL),
            thrust_min: of("posCtlPid.thrustMin"),
            thrust_base: of("posCtlPid.thrustBase"),
            yaw_ps: of("pid_attitude.yaw_kp"),
        }
    }
}

/// Gains that divide are never quite nothing.
const SMALL: f64 = 1e-6;

/// Place of a parameter in the table.
pub(crate) fn index(name: &str) -> Option<usize> {
    PARAMS.iter().position(|param| param.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_the_cascades_own() {
        assert_eq!(ParamValues::new().gains(), CascadeGains::default());
    }

    #[test]
    fn gains_of_nonsense_are_numbers() {
        let mut values = ParamValues::new();
        for name in ["posCtlPid.zKi", "velCtlPid.vzKp", "velCtlPid.vxKi", "posCtlPid.rpLimit"] {
            values.set(name, f64::NAN);
            values.set("posCtlPid.xKp", -5.0);
        }
        let gains = values.gains();
        assert_eq!(gains.position_ps[0], 0.0);
        assert!(gains.height_integral_ps2 > 0.0 && gains.thrust_per_mps > 0.0);
    }
}
