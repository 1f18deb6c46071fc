//! A battery that empties.

use super::{Call, Effect, HookContext, Hooks, Param, Reading, Ubiquity, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct BatterySag;

impl Effect<4, 4> for BatterySag {
    const NAME: &'static str = "battery_sag";
    const ABOUT: &'static str = "The voltage falls with charge and current; thrust goes with a power of it";
    const SOURCE: &'static str = "Discharge curve of Tremblay, Dessaint and Dekkiche 2007 with 4.2 V full; current as thrust^1.5 (momentum theory)";
    const PARAMS: [Param; 4] = [
        param("exponent", "1", 0.0, [0.0, 4.0])
            .about("thrust goes as (voltage / reference voltage)^exponent; 2 without compensation"),
        param("charge", "1", 1.0, [0.05, 1.0]).about("at the start of the episode").constant(),
        param("resistance_ohm", "ohm", 0.0, [0.0, 0.5])
            .about("inner resistance; about 0.1 measured on a Crazyflie")
            .constant(),
        param("torque_share", "1", 0.0, [0.0, 1.0])
            .about("how much the torques share: 0 where the attitude loop makes up for it, 1 where 5.1 and 5.2 lose as the thrust"),
    ];
    const HOOKS: Hooks = Hooks::PUSH_AND_SENSE;
    const IS_BATTERY: bool = true;
    const UBIQUITY: Ubiquity = Ubiquity::AllWithVoltage;

    #[inline(always)]
    fn start<R: Scalar>(cx: Call<R, 4>, _: &Command<R>) -> [R; 4] {
        let &[_, charge, _, _] = cx.params;
        let bulge = (R::from_f64(DECAY) * (charge - R::from_f64(1.0))).exp();
        [charge, R::zero(), open_circuit_v(charge, bulge), bulge]
    }

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 4>, s: &mut [R; 4], u: &Command<R>, out: &mut Accelerations<R>) {
        let &[exponent, _, resistance_ohm, torque_share] = cx.params;
        // the charge moves slowly: once per control tick is enough
        if cx.first {
            let current = current_a(&cx, u);
            let used = (current * R::from_f64(cx.tick_s) * cx.body.per_battery_capacity_pc).min(s[0]);
            s[0] -= used;
            // exp(-decay used) for the ten-thousandth part of a charge that a tick uses
            let fall = R::from_f64(DECAY) * used;
            s[3] -= s[3] * fall * (R::from_f64(1.0) - R::from_f64(0.5) * fall);
            let reference = cx.body.battery_reference_v;
            let (voltage, full) = match cx.voltage_v {
                Some(measured) => (*measured, reference),
                None => (
                    open_circuit_v(s[0], s[3]) - resistance_ohm * current,
                    reference - resistance_ohm * cx.body.hover_current_a,
                ),
            };
            s[2] = voltage.max(R::from_f64(1.0));
            s[1] = (s[2] / full).powf(exponent) - R::from_f64(1.0);
        }
        out.acc_mps2[2] += cx.body.thrust_mps2(u, out) * s[1];
        cx.body.add_torque(torque_share * s[1], cx.h_s, cx.x, u, out);
    }

    #[inline(always)]
    fn sense<R: Scalar>(_: Call<R, 4>, s: &mut [R; 4], y: &mut Reading<R>) {
        y.vbat_v = s[2];
    }
}

/// Voltage of a full lithium-polymer cell.
const FULL_V: f64 = 4.2;

/// E0 - K / charge + A exp(-DECAY (1 - charge)), with A and K from the full (4.2 V), nominal (3.7 V) and
/// empty points of a 240 mAh cell; `bulge` is the exponential.
#[inline(always)]
fn open_circuit_v<R: Scalar>(charge: R, bulge: R) -> R {
    let (knee, a) = (0.01, 0.45);
    R::from_f64(FULL_V + knee - a) - R::from_f64(knee) / charge.max(R::from_f64(0.01))
        + R::from_f64(a) * bulge
}

const DECAY: f64 = 3.0;

/// Power goes as thrust^1.5 in hover; the thesis's 240 mAh last 4 minutes at thrust ratio 1.
#[inline(always)]
fn current_a<R: Scalar>(cx: &HookContext<R>, u: &Command<R>) -> R {
    let ratio = cx.body.thrust_ratio(u).max(R::zero());
    cx.body.hover_current_a * ratio * ratio.sqrt()
}
