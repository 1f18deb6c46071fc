//! Set-points of the commander and the generic commander: packets into what a drone is to do.

use crazyflie_env::action::{LateralSetpoint, VerticalSetpoint, YawSetpoint};

use crate::packet::Fields;

/// Set-point of a drone until the next one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Setpoint {
    pub lateral: LateralSetpoint,
    /// A velocity is along the nose and to the left, not along the room's axes.
    pub in_body: bool,
    pub vertical: VerticalSetpoint,
    pub yaw: YawSetpoint,
}

/// Roll, pitch, yaw rate and thrust as the first of all commanders takes them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct AttitudeSetpoint {
    /// Roll and pitch.
    pub tilt_rad: [f64; 2],
    /// In the vehicle's own sign, as the model's command was identified.
    pub yaw_rate_radps: f64,
    pub thrust_pwm: f64,
}

/// A request of the generic commander.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum GenericSetpoint {
    Stop,
    Fly(Setpoint),
    /// Roll, pitch, right-handed yaw rate and thrust.
    Manual(AttitudeSetpoint),
}

/// Largest and least thrust that the commander passes on.
const THRUST_MAX: f64 = 60_000.0;
const THRUST_MIN: f64 = 1_000.0;

/// Returns the motors' PWM for a set-point's thrust.
pub(crate) fn thrust(pwm: f64) -> f64 {
    if pwm < THRUST_MIN { 0.0 } else { pwm.min(THRUST_MAX) }
}

/// The wire has the firmware's pitch, which lifts the nose.
pub(crate) fn attitude(mut fields: Fields<'_>) -> Option<AttitudeSetpoint> {
    let [roll_deg, pitch_deg, yaw_degps]: [f64; 3] = fields.f32s()?;
    Some(AttitudeSetpoint {
        tilt_rad: [roll_deg.to_radians(), -pitch_deg.to_radians()],
        yaw_rate_radps: yaw_degps.to_radians(),
        thrust_pwm: fields.u16()?.into(),
    })
}

/// A set-point of the generic commander; nothing for types that there are not, and what is too short.
pub(crate) fn generic(mut fields: Fields<'_>) -> Option<GenericSetpoint> {
    let kind = fields.u8()?;
    let (lateral, in_body, vertical, yaw) = match kind {
        0 => return Some(GenericSetpoint::Stop),
        11 => return manual(fields),
        6 => return full_state(fields).map(GenericSetpoint::Fly),
        7 => {
            let [x, y, z, yaw_deg] = fields.f32s()?;
            return Some(GenericSetpoint::Fly(place([x, y, z], yaw_deg.to_radians())));
        }
        // the older forms turn the other way round
        1 | 8 => {
            let [x, y, z, yaw_degps] = fields.f32s()?;
            (LateralSetpoint::Velocity([x, y]), false, VerticalSetpoint::Climb(z), turn(yaw_degps, kind == 1))
        }
        2 | 9 => {
            let [roll_deg, pitch_deg, yaw_degps, z] = fields.f32s()?;
            let tilt_rad = [roll_deg.to_radians(), -pitch_deg.to_radians()];
            (LateralSetpoint::Tilt(tilt_rad), false, VerticalSetpoint::Height(z), turn(yaw_degps, kind == 2))
        }
        5 | 10 => {
            let [x, y, yaw_degps, z] = fields.f32s()?;
            (LateralSetpoint::Velocity([x, y]), true, VerticalSetpoint::Height(z), turn(yaw_degps, kind == 5))
        }
        _ => return None,
    };
    Some(GenericSetpoint::Fly(Setpoint { lateral, in_body, vertical, yaw }))
}

pub(crate) fn place([x, y, z]: [f64; 3], yaw_rad: f64) -> Setpoint {
    Setpoint {
        lateral: LateralSetpoint::Place([x, y]),
        in_body: false,
        vertical: VerticalSetpoint::Height(z),
        yaw: YawSetpoint::Heading(yaw_rad),
    }
}

fn turn(degps: f64, clockwise: bool) -> YawSetpoint {
    let radps = degps.to_radians();
    YawSetpoint::Rate(if clockwise { -radps } else { radps })
}

/// Roll and pitch rates are below the level of the identified model: such a set-point is ignored.
fn manual(mut fields: Fields<'_>) -> Option<GenericSetpoint> {
    let setpoint = attitude(Fields(fields.0.get(..14)?))?;
    fields.0 = &fields.0[14..];
    let rates = fields.u8()?;
    (rates == 0).then_some(GenericSetpoint::Manual(setpoint))
}

/// Decodes a full state, of which the PID controller flies place and heading, like the firmware's.
fn full_state(mut fields: Fields<'_>) -> Option<Setpoint> {
    let place_mm: [f64; 3] = fields.i16s()?;
    let _velocity_and_acceleration: [f64; 6] = fields.i16s()?;
    let yaw_rad = heading_rad(quaternion(fields.u32()?));
    Some(place(place_mm.map(|mm| mm * 1e-3), yaw_rad))
}

/// The heading of an attitude x, y, z, w.
pub(crate) fn heading_rad([x, y, z, w]: [f64; 4]) -> f64 {
    (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z))
}

/// Two bits name the largest part, which is left out; the other three are a sign and nine bits of what is at
/// most 1 / sqrt(2), the last in the lowest bits.
fn quaternion(mut packed: u32) -> [f64; 4] {
    let largest = (packed >> 30) as usize;
    let mut parts = [0.0; 4];
    let mut squares = 0.0;
    for i in (0..4).rev().filter(|i| *i != largest) {
        let size = f64::from(packed & 0x1ff) / 511.0 * std::f64::consts::FRAC_1_SQRT_2;
        parts[i] = if packed >> 9 & 1 == 1 { -size } else { size };
        squares += size * size;
        packed >>= 10;
    }
    parts[largest] = (1.0 - squares).max(0.0).sqrt();
    parts
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn bytes(kind: u8, numbers: &[f32]) -> Vec<u8> {
        std::iter::once(kind).chain(numbers.iter().flat_map(|number| number.to_le_bytes())).collect()
    }

    #[test]
    fn signs_are_the_firmwares() {
        let fly = |kind, numbers: &[f32]| match generic(Fields(&bytes(kind, numbers))) {
            Some(GenericSetpoint::Fly(setpoint)) => setpoint,
            other => panic!("{other:?}"),
        };
        let right_handed = YawSetpoint::Rate(90_f64.to_radians());
        assert_eq!(fly(10, &[0.1, 0.0, 90.0, 0.5]).yaw, right_handed);
        assert_eq!(fly(5, &[0.1, 0.0, -90.0, 0.5]).yaw, right_handed);
        assert!(fly(10, &[0.1, 0.0, 90.0, 0.5]).in_body && !fly(8, &[0.1, 0.0, 0.0, 0.0]).in_body);
        let numbers: Vec<u8> = bytes(0, &[1.0, -2.0, 0.0])[1..].iter().copied().chain([16, 39]).collect();
        let attitude = attitude(Fields(&numbers)).unwrap();
        assert!(attitude.tilt_rad[1] > 0.0 && attitude.thrust_pwm == 10_000.0);
    }

    #[test]
    fn a_packed_heading_is_that_heading() {
        // half a right angle about z: z = sin(pi/8) in nine bits, w left out
        let z = (std::f64::consts::FRAC_PI_8.sin() * std::f64::consts::SQRT_2 * 511.0).round() as u32;
        let off_rad = heading_rad(quaternion(3 << 30 | z)) - std::f64::consts::FRAC_PI_4;
        assert!(off_rad.abs() < 2e-3, "{off_rad}");
        let [_, _, z, w] = quaternion(2 << 30);
        assert_eq!((z, w), (1.0, 0.0));
    }

    #[test]
    fn thrust_is_cut_off_as_the_firmware_does() {
        assert_eq!([thrust(999.0), thrust(1000.0), thrust(65_535.0)], [0.0, 1000.0, 60_000.0]);
    }

    proptest! {
        #[test]
        fn every_packet_is_a_finite_set_point_or_none(data in proptest::collection::vec(any::<u8>(), 0..31)) {
            if let Some(GenericSetpoint::Fly(setpoint)) = generic(Fields(&data)) {
                let numbers = match setpoint.lateral {
                    LateralSetpoint::Place(xy) | LateralSetpoint::Velocity(xy) | LateralSetpoint::Tilt(xy) => xy,
                };
                prop_assert!(numbers.iter().all(|number| number.is_finite()));
            }
            let _ = attitude(Fields(&data));
        }
    }
}
