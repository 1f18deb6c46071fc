//! Markers of a motion capture that lie askew on the vehicle.

use super::{Call, Effect, FlightSpread, Hooks, Observability, Param, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct MarkerTilt;

impl Effect<2, 0> for MarkerTilt {
    const NAME: &'static str = "marker_tilt";
    const ABOUT: &'static str = "The attitude is that of a marker frame which lies askew on the vehicle: its thrust leans by the error less";
    const SOURCE: &'static str = "Motion capture takes the frame of the markers at first sight for level; differs by about a degree from session to session";
    const PARAMS: [Param; 2] = [
        param("roll_deg", "deg", 0.0, [-10.0, 10.0])
            .about("roll of the marker frame minus that of the vehicle"),
        param("pitch_deg", "deg", 0.0, [-10.0, 10.0])
            .about("pitch of the marker frame minus that of the vehicle"),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    const OBSERVABILITY: Observability = Observability::Session;
    // askew by about a degree, differently in each session: with room to spare
    const FLIGHT_SPREAD: FlightSpread = FlightSpread::Frame(3.0);

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 2>, _: &mut [R; 0], _: &Command<R>, out: &mut Accelerations<R>) {
        let &[roll_deg, pitch_deg] = cx.params;
        let strength = cx.body.gravity_mps2 * R::from_f64(std::f64::consts::PI / 180.0);
        let (front, right) = (-strength * pitch_deg, -strength * roll_deg);
        let (sin, cos) = cx.x.att_rad[2].sin_cos();
        out.acc_mps2[0] += cos * front + sin * right;
        out.acc_mps2[1] += sin * front - cos * right;
    }
}
