//! A scene as data.

use crate::vector::V3;

/// A drone: position of its centre of mass in metres (x right, y forward, z up), attitude in radians
/// (right-handed; positive pitch accelerates to +x, positive roll to -y), colour as RGB.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drone {
    /// Position of the centre of mass in metres.
    pub pos_m: [f32; 3],
    /// Roll about the body's x axis in radians.
    pub roll_rad: f32,
    /// Pitch about y in radians.
    pub pitch_rad: f32,
    /// Yaw about z in radians; at zero the nose points along +x.
    pub yaw_rad: f32,
    /// Colour of body and rotors, RGB.
    pub color: [u8; 3],
}

/// An ArUco marker flat on the floor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Marker {
    /// Centre, x in metres.
    pub x_m: f32,
    /// Centre, y in metres.
    pub y_m: f32,
    /// Rotation about z in radians.
    pub yaw_rad: f32,
    /// Side of the black square in metres, 0.197 by default.
    pub side_m: f32,
}

impl Default for Marker {
    fn default() -> Self {
        Self { x_m: 0.0, y_m: 0.0, yaw_rad: 0.0, side_m: 0.197 }
    }
}

impl Marker {
    /// A floor point given in the marker's own frame, in units of its side: (-0.5, -0.5) is a corner.
    pub(crate) fn point(&self, u: f32, v: f32) -> V3 {
        let (s, c) = self.yaw_rad.sin_cos();
        let (x, y) = (u * self.side_m, v * self.side_m);
        [self.x_m + c * x - s * y, self.y_m + s * x + c * y, 0.0]
    }

    pub(crate) fn corners_m(&self) -> [V3; 4] {
        [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)].map(|(u, v)| self.point(u, v))
    }
}

/// Everything one frame shows. All lengths are metres in the room's frame: x right, y forward, z up.
#[derive(Debug, Clone, Copy, Default)]
pub struct Scene<'a> {
    /// The drones.
    pub drones: &'a [Drone],
    /// Positions flown so far by each drone, oldest first; they fade with age. Each has its drone's colour, a
    /// single one its own.
    pub trails_m: &'a [&'a [[f32; 3]]],
    /// Set-points of the drones.
    pub setpoints_m: &'a [[f32; 3]],
    /// Reference path; may be empty.
    pub path_m: &'a [[f32; 3]],
    /// Markers on the floor.
    pub markers: &'a [Marker],
    /// Last position that the camera reported.
    pub fix_m: Option<[f32; 3]>,
    /// Angle of view of each drone's downward camera over the image diagonal, in radians, between 0 and pi.
    /// The image is 3 wide (along the body's x) by 2 high, as 720 x 480.
    pub camera_fov_rad: Option<f32>,
}
