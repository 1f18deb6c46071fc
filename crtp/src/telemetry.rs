//! What a drone shows of itself after a tick: the source of every log variable.

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
    pub connected: bool,
    pub extpos_m: [f64; 3],
    pub true_pos_m: [f64; 3],
}

impl Telemetry {
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
