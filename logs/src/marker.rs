//! Poses of the marker: which frame they are in, and in which row they arrive.

use super::Note;
use super::align::Track;
use super::attitude::Rotation;
use super::samples::Samples;
use super::signal::unwrap;
use crazyflie_statistics::quantile;

/// Poses in a world frame with z up.
#[derive(Debug)]
pub(super) struct Marker {
    pub(super) samples: Samples,
    pub(super) pos_m: [Vec<f64>; 3],
    /// Yaw, if the poses have an orientation.
    pub(super) yaw_rad: Option<Vec<f64>>,
    angles_rad: Option<[Vec<f64>; 3]>,
}

impl Marker {
    /// Reads poses of the vehicle over the marker, or of the marker in the frame of a camera that looks down
    /// on it, as `ar_sys` publishes them: then the marker's z axis points at the camera, and the pose is
    /// turned round.
    pub(super) fn from_samples(samples: Samples, notes: &mut Vec<Note>) -> Self {
        let rotations: Option<Vec<Rotation>> =
            samples.values.iter().map(|v| Rotation::from_xyzw([v[3], v[4], v[5], v[6]])).collect();
        let Some(mut rotations) = rotations else {
            let pos_m = samples.triple(0);
            return Self { samples, pos_m, yaw_rad: None, angles_rad: None };
        };
        let mut pos_m = samples.triple(0);
        let up: Vec<f64> = rotations.iter().map(|r| r.turn([0.0, 0.0, 1.0])[2]).collect();
        if quantile(&up, 0.5).unwrap_or(0.0) < 0.0 {
            notes.push(Note::SeenFromCamera);
            // The camera's x axis is the vehicle's, its z axis points down.
            let body = Rotation::from_angles([std::f64::consts::PI, 0.0, 0.0]);
            for (row, rotation) in rotations.iter_mut().enumerate() {
                let camera = rotation.inverse();
                let seen = camera.turn([0, 1, 2].map(|axis| pos_m[axis][row]));
                for (axis, value) in pos_m.iter_mut().zip(seen) {
                    axis[row] = -value;
                }
                *rotation = camera.then(body);
            }
        }
        let angles = [0, 1, 2].map(|axis| rotations.iter().map(|r| r.angles()[axis]).collect::<Vec<f64>>());
        Self { samples, pos_m, yaw_rad: Some(angles[2].clone()), angles_rad: Some(angles) }
    }

    /// Roll, pitch and yaw at the rows, where no IMU measured them.
    pub(super) fn attitude(&self, rows_s: &[f64], notes: &mut Vec<Note>) -> Option<[Vec<f64>; 3]> {
        let mut angles = self.angles_rad.clone()?;
        notes.push(Note::AttitudeFromMarker);
        unwrap(&mut angles[2], "marker yaw", &mut Vec::new());
        Some(angles.each_ref().map(|values| {
            let track = Track { t_s: &self.samples.t_s, values };
            rows_s.iter().map(|t| track.value_at(*t)).collect()
        }))
    }
}

/// Returns the rows in which samples arrive, ascending, and the sample of each. A row has one sample: a second one
/// waits for the next row. Samples after the last row are dropped.
pub(super) fn arrivals(arrived_s: &[f64], rows_s: &[f64]) -> (Vec<usize>, Vec<usize>) {
    let mut order: Vec<usize> = (0..arrived_s.len()).collect();
    order.sort_by(|a, b| arrived_s[*a].total_cmp(&arrived_s[*b]));
    let (mut rows, mut samples) = (Vec::new(), Vec::new());
    let mut free = 0;
    for at in order {
        let row = rows_s.partition_point(|t| *t < arrived_s[at]).max(free);
        if row >= rows_s.len() {
            break;
        }
        rows.push(row);
        samples.push(at);
        free = row + 1;
    }
    (rows, samples)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_arrivals_take_two_rows_and_late_ones_none() {
        let (rows, samples) = arrivals(&[0.011, 0.012, 0.5, 9.0], &[0.0, 0.01, 0.02, 0.03, 0.5]);
        assert_eq!((rows, samples), (vec![2, 3, 4], vec![0, 1, 2]));
    }

    #[test]
    fn a_marker_seen_from_above_gives_the_vehicle_over_it() {
        // The vehicle at (0.3, -0.2, 0.7) over the marker with a yaw of 0.4; the camera turned half round its
        // x axis.
        let vehicle = Rotation::from_angles([0.0, 0.0, 0.4]);
        let camera = vehicle.then(Rotation::from_angles([std::f64::consts::PI, 0.0, 0.0]));
        let seen = camera.inverse().turn([-0.3, 0.2, -0.7]);
        // The pose of the marker in the camera's frame.
        let [x, y, z, w] = camera.inverse().xyzw();
        let samples = Samples {
            t_s: vec![0.0],
            arrived_s: vec![0.0],
            values: vec![vec![seen[0], seen[1], seen[2], x, y, z, w]],
            clock: None,
        };
        assert!(seen[2] > 0.6);
        let mut notes = Vec::new();
        let marker = Marker::from_samples(samples, &mut notes);
        assert_eq!(notes, [Note::SeenFromCamera]);
        let pos_m = [0, 1, 2].map(|axis| marker.pos_m[axis][0]);
        assert!(pos_m.iter().zip([0.3, -0.2, 0.7]).all(|(a, b)| (a - b).abs() < 1e-9), "{pos_m:?}");
        assert!((marker.yaw_rad.unwrap()[0] - 0.4).abs() < 1e-9);
    }
}
