//! Three-component arithmetic, as little as the renderer needs.

pub(crate) type V3 = [f32; 3];

pub(crate) fn add(a: V3, b: V3) -> V3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

pub(crate) fn sub(a: V3, b: V3) -> V3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(crate) fn scale(a: V3, k: f32) -> V3 {
    [a[0] * k, a[1] * k, a[2] * k]
}

pub(crate) fn dot(a: V3, b: V3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn mix(a: V3, b: V3, t: f32) -> V3 {
    add(a, scale(sub(b, a), t))
}

pub(crate) fn length(a: V3) -> f32 {
    dot(a, a).sqrt()
}

/// The point straight below on the floor.
pub(crate) fn on_floor(a: V3) -> V3 {
    [a[0], a[1], 0.0]
}

/// Turns body vectors into world vectors: yaw about z, then pitch about y, then roll about x, all
/// right-handed.
#[derive(Clone, Copy)]
pub(crate) struct Rotation([V3; 3]);

impl Rotation {
    pub(crate) fn new(roll: f32, pitch: f32, yaw: f32) -> Self {
        let (sr, cr) = roll.sin_cos();
        let (sp, cp) = pitch.sin_cos();
        let (sy, cy) = yaw.sin_cos();
        Self([
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ])
    }

    pub(crate) fn apply(&self, v: V3) -> V3 {
        [dot(self.0[0], v), dot(self.0[1], v), dot(self.0[2], v)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tilt_points_the_thrust_as_the_vehicle_accelerates() {
        let pitched = Rotation::new(0.0, 0.2, 0.0).apply([0.0, 0.0, 1.0]);
        assert!(pitched[0] > 0.19 && pitched[1].abs() < 1e-6);
        let rolled = Rotation::new(0.2, 0.0, 0.0).apply([0.0, 0.0, 1.0]);
        assert!(rolled[1] < -0.19 && rolled[0].abs() < 1e-6);
    }

    #[test]
    fn yaw_turns_the_nose_to_the_left() {
        let nose = Rotation::new(0.0, 0.0, std::f32::consts::FRAC_PI_2).apply([1.0, 0.0, 0.0]);
        assert!((nose[1] - 1.0).abs() < 1e-6);
    }
}
