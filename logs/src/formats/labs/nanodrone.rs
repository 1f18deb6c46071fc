//! The nano-drone system-identification benchmark (Busetto, Cereda et al. 2025, arXiv 2512.14450): a
//! Crazyflie 2.1 Brushless at 100 Hz, whose speed controllers report the speed of each rotor. State is the
//! vehicle's estimate with motion capture in it.

use crate::attitude::Rotation;
use crate::columns::Layout;
use crate::signal::{time_gaps, unwrap};
use crate::table::{Accept, NUMBER, Table};
use crate::{AttitudeSource, Fixes, FlightLog, Note, Onboard, PositionSource, Provenance, Reader, Result};

const LAYOUT: Layout = Layout {
    required: &[&["t", "x", "y", "z", "qx", "qy", "qz", "qw", "vx", "vy", "vz", "wx", "wy", "wz"], &MOTOR],
    optional: &[&[VBAT]],
    ..Layout::NONE
};
const MOTOR: [&str; 4] = ["m1_rads", "m2_rads", "m3_rads", "m4_rads"];
const VBAT: &str = "Vbat";
/// Several times the top speed of a rotor of this size.
const SPEED: Accept = Accept::between(0.0, 10_000.0, "a rotor speed from 0 to 10000 rad/s");
const AIRBORNE_M: f64 = 0.1;

pub(crate) static READER: Reader = Reader {
    name: "nanodrone_csv",
    title: "a nano-drone benchmark CSV",
    layout: Some(&LAYOUT),
    read: |content, notes| read(content.table()?, notes),
    ..Reader::TEXT
};

fn read(table: &Table, mut notes: Vec<Note>) -> Result<FlightLog> {
    let t_s = table.time("t")?;
    time_gaps(&t_s, &mut notes);
    let [roll_rad, pitch_rad, mut yaw_rad] = attitude(table)?;
    unwrap(&mut yaw_rad, "yaw", &mut notes);
    let speeds: Result<Vec<Vec<f64>>> = MOTOR.iter().map(|c| table.column(c, SPEED)).collect();
    let vbat_v = if table.has(VBAT) { Some(table.column(VBAT, NUMBER)?) } else { None };
    let provenance = Provenance::new(READER.name, PositionSource::MotionCapture, AttitudeSource::Imu);
    let mut log = FlightLog {
        fixes: Fixes::in_every_row(&t_s, table.triple(["x", "y", "z"])?),
        vel_mps: Some(table.triple(["vx", "vy", "vz"])?),
        roll_rad,
        pitch_rad,
        yaw_rad,
        gyro_radps: Some(table.triple(["wx", "wy", "wz"])?),
        vbat_v,
        onboard: Some(Onboard { rotor_radps: speeds?.try_into().ok(), ..Onboard::default() }),
        ..FlightLog::empty(provenance, t_s)
    };
    log.find_airborne(AIRBORNE_M);
    Ok(log.with_notes(notes))
}

/// Roll, pitch and yaw of the quaternions; where one is no rotation, those of the row before.
fn attitude(table: &Table) -> Result<[Vec<f64>; 3]> {
    let [x, y, z] = table.triple(["qx", "qy", "qz"])?;
    let w = table.column("qw", NUMBER)?;
    let mut angles = [const { Vec::new() }; 3];
    let mut last = [0.0; 3];
    for row in 0..w.len() {
        if let Some(rotation) = Rotation::from_xyzw([x[row], y[row], z[row], w[row]]) {
            last = rotation.angles();
        }
        angles.iter_mut().zip(last).for_each(|(out, angle)| out.push(angle));
    }
    Ok(angles)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three rows at a height, turned by 0.2 rad about y, the published order of columns with one that nobody
    /// needs.
    fn text(speed: &str) -> String {
        let mut text = String::from(
            ",t,x,y,z,qx,qy,qz,qw,vx,vy,vz,wx,wy,wz,m1_rads,m2_rads,m3_rads,m4_rads,Vbat,is_flying\n",
        );
        for row in 0..3 {
            text += &format!(
                "{row},0.0{row},0,0,0.5,0,{},0,{},0,0,0,0,0,0,{speed},1700,1700,1700,3.9,True\n",
                0.1_f64.sin(),
                0.1_f64.cos()
            );
        }
        text
    }

    #[test]
    fn speeds_and_quaternions_are_read() {
        let log = FlightLog::from_bytes("made.csv", text("1650").as_bytes()).unwrap();
        assert_eq!((log.provenance.format, log.airborne.clone()), ("nanodrone_csv", 0..3));
        assert!((log.pitch_rad[1] - 0.2).abs() < 1e-9, "{:?}", log.pitch_rad);
        assert_eq!(log.onboard.unwrap().rotor_radps.unwrap()[0], [1650.0; 3]);
    }

    proptest::proptest! {
        /// Damaged bytes give an error, or a flight of finite numbers.
        #[test]
        fn damaged_files_give_errors_or_finite_flights(places in proptest::collection::vec((0_usize..400, proptest::num::u8::ANY), 0..6)) {
            let mut bytes = text("1650").into_bytes();
            let length = bytes.len();
            places.into_iter().for_each(|(at, byte)| bytes[at % length] = byte);
            if let Ok(log) = FlightLog::from_bytes("damaged.csv", &bytes) {
                let speeds = log.onboard.and_then(|o| o.rotor_radps).into_iter().flatten().flatten();
                proptest::prop_assert!(speeds.chain(log.roll_rad).chain(log.pitch_rad).chain(log.t_s).all(f64::is_finite));
            }
        }
    }

    #[test]
    fn a_speed_that_no_rotor_has_is_an_error_with_its_line() {
        let error = FlightLog::from_bytes("made.csv", text("-5").as_bytes()).unwrap_err().to_string();
        assert!(
            error.contains("line 2") && error.contains("m1_rads") && error.contains("rotor speed"),
            "{error}"
        );
    }
}
