//! State of a drone after a tick: the source of every log variable.

use crazyflie_env::plant::State;

use crate::supervisor::Request;

/// Numbers of a drone at a moment. Angles are right-handed; the tables turn the signs that the firmware turns.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Telemetry {
    /// Since the program began, simulated.
    pub time_ms: u32,
    pub tick_s: f64,
    pub pos_m: [f64; 3],
    pub vel_mps: [f64; 3],
    pub var_pos_m2: [f64; 3],
    pub var_vel_m2ps2: [f64; 3],
    pub att_deg: [f64; 3],
    pub gyro_degps: [f64; 3],
    pub acc_g: [f64; 3],
    pub vbat_v: f64,
    pub battery_percent: f64,
    pub power_state: f64,
    pub thrust_pwm: f64,
    /// Roll, pitch, yaw rate.
    pub asked_deg: [f64; 3],
    pub target_m: [f64; 3],
    pub target_mps: [f64; 3],
    pub target_yaw_deg: f64,
    /// Bits of the supervisor.
    pub info: u16,
    /// Touches another vehicle, which a tumble check sees.
    pub touches: bool,
    /// Request of a script in this tick that the supervisor may refuse.
    pub request: Option<Request>,
    pub connected: bool,
    pub extpos_m: [f64; 3],
    pub true_pos_m: [f64; 3],
    /// Clear way to the front, back, left, right and up, and down to the floor.
    pub clear_m: [f64; 6],
    /// Counts of a Flow deck along the body's axes in a tick.
    pub flow: [f64; 2],
}

/// Reading of a Multi-ranger without anything near enough, mm.
const OUT_OF_RANGE_MM: f64 = 32_766.0;
/// Reach of a Multi-ranger.
const RANGE_M: f64 = 4.0;
/// Pixels per radian of a Flow deck's camera, and its counts per pixel (crazyflie-firmware, mm_flow.c).
const FLOW_PER_RAD: f64 = 35.0 / 0.71674 * 10.0;
/// Nearer to the floor than this it counts as from there.
const FLOW_LEAST_M: f64 = 0.1;

/// Clear way of a vehicle in a room whose walls are `half_m` from its middle and whose ceiling is at `ceiling_m`.
pub(crate) fn clear_m(state: &State<f64>, [half_m, ceiling_m]: [f64; 2]) -> [f64; 6] {
    let [x, y, z] = state.pos_m;
    let to_wall = |turned_rad: f64| {
        let (sin, cos) = (state.att_rad[2] + turned_rad).sin_cos();
        let along = |place: f64, way: f64| {
            if way == 0.0 { f64::INFINITY } else { (half_m.copysign(way) - place) / way }
        };
        along(x, cos).min(along(y, sin)).max(0.0)
    };
    let quarter = std::f64::consts::FRAC_PI_2;
    [
        to_wall(0.0),
        to_wall(2.0 * quarter),
        to_wall(quarter),
        to_wall(-quarter),
        (ceiling_m - z).max(0.0),
        z.max(0.0),
    ]
}

/// Counts of a Flow deck over a tick.
pub(crate) fn flow(state: &State<f64>, gyro_radps: [f64; 3], tick_s: f64) -> [f64; 2] {
    let (sin, cos) = state.att_rad[2].sin_cos();
    let ([vx, vy, _], height_m) = (state.vel_mps, state.pos_m[2].max(FLOW_LEAST_M));
    let (front, left) = (cos * vx + sin * vy, cos * vy - sin * vx);
    [front / height_m - gyro_radps[1], left / height_m + gyro_radps[0]]
        .map(|radps| radps * tick_s * FLOW_PER_RAD)
}

impl Telemetry {
    /// Returns the measurements of these decks: a quantity that none of them measures is zero.
    pub fn seen_by(self, decks: &[&str]) -> Self {
        let has = |names: &[&str]| names.iter().any(|name| decks.contains(name));
        let mut seen = self;
        if !has(&["deck.bcMultiranger"]) {
            seen.clear_m[..5].fill(0.0);
        }
        if !has(&["deck.bcFlow2", "deck.bcZRanger2"]) {
            seen.clear_m[5] = 0.0;
        }
        if !has(&["deck.bcFlow2"]) {
            seen.flow = [0.0; 2];
        }
        seen
    }

    /// A clear way as the range decks send it.
    pub fn range_mm(&self, way: usize) -> f64 {
        let clear_m = self.clear_m[way];
        if clear_m > RANGE_M { OUT_OF_RANGE_MM } else { 1e3 * clear_m }
    }

    /// The attitude in 32 bits: which component is largest, and of the others sign and nine bits.
    pub fn packed_quaternion(&self) -> f64 {
        let parts = self.quaternion();
        let largest = (0..4).fold(0, |best, i| if parts[i].abs() > parts[best].abs() { i } else { best });
        let mut packed = largest as u32;
        for (_, part) in parts.into_iter().enumerate().filter(|(place, _)| *place != largest) {
            let negative = (part < 0.0) != (parts[largest] < 0.0);
            let size = 511.0 * part.abs() / std::f64::consts::FRAC_1_SQRT_2 + 0.5;
            packed = packed << 10 | u32::from(negative) << 9 | (size as u32).min(511);
        }
        packed.into()
    }

    /// The attitude as x, y, z, w.
    pub fn quaternion(&self) -> [f64; 4] {
        quaternion(self.att_deg.map(f64::to_radians))
    }
}

/// An attitude of yaw, then pitch, then roll as x, y, z, w.
pub(crate) fn quaternion(att_rad: [f64; 3]) -> [f64; 4] {
    let [(sr, cr), (sp, cp), (sy, cy)] = att_rad.map(|rad| (0.5 * rad).sin_cos());
    [
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    ]
}
