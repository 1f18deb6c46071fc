//! Wind that differs from place to place: velocities of the air on a regular grid.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, check_range, out_of_range};
use crate::scalar::tabulate;

/// Twice the wind with which a hurricane begins (33 m/s): more is a mistake of units.
const FASTEST_MPS: f64 = 66.0;
/// Points of a grid, of twelve bytes each.
const MOST_POINTS: usize = 1 << 22;

/// Velocities of the air at the points of a grid, steady in time. Between points they are interpolated along each
/// axis (trilinearly); beyond the grid the air moves as at its nearest face.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "WindTable", into = "WindTable")]
pub struct WindField(Arc<Grid>);

/// A wind field as it is written.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct WindTable {
    /// The grid's first point, in the world frame.
    origin_m: [f64; 3],
    /// From point to point, along x, y and z.
    spacing_m: [f64; 3],
    /// By x, then y, then z.
    velocity_mps: Vec<Vec<Vec<[f32; 3]>>>,
}

#[derive(Debug, PartialEq)]
struct Grid {
    origin_m: [f64; 3],
    spacing_m: [f64; 3],
    counts: [usize; 3],
    /// By x, then y, then z.
    velocity_mps: Vec<[f32; 3]>,
}

impl WindField {
    /// Creates a field from velocities by x, then y, then z, as many along each axis as in `counts`.
    ///
    /// # Errors
    /// [`Error::Range`] for no points or too many, for a spacing that is not positive, and for what is not finite
    /// or faster than any wind; [`Error::Shape`] for another number of velocities.
    pub fn new(
        origin_m: [f64; 3],
        spacing_m: [f64; 3],
        counts: [usize; 3],
        velocity_mps: Vec<[f32; 3]>,
    ) -> Result<Self> {
        for axis in 0..3 {
            check_range(&format!("wind_field: origin_m[{axis}]"), origin_m[axis], -1e3, 1e3)?;
            check_range(&format!("wind_field: spacing_m[{axis}]"), spacing_m[axis], 1e-3, 1e3)?;
            let name = format!("wind_field: points along axis {axis}");
            check_range(&name, counts[axis] as f64, 1.0, MOST_POINTS as f64)?;
        }
        let points = counts.iter().try_fold(1_usize, |product, count| product.checked_mul(*count));
        let points = points.unwrap_or(usize::MAX);
        check_range("wind_field: points", points as f64, 1.0, MOST_POINTS as f64)?;
        crate::error::check_length("velocity_mps", points, velocity_mps.len())?;
        let fast = |mps: &f32| mps.is_nan() || f64::from(mps.abs()) > FASTEST_MPS;
        if let Some(i) = velocity_mps.iter().position(|velocity| velocity.iter().any(fast)) {
            let [_, along_y, along_z] = counts;
            let place = [i / (along_y * along_z), i / along_z % along_y, i % along_z];
            let axis = velocity_mps[i].iter().position(fast).unwrap_or(0);
            let [x, y, z] = place;
            return Err(out_of_range(
                format!("wind_field: velocity_mps[{x}][{y}][{z}][{axis}]"),
                velocity_mps[i][axis].into(),
                format!("{} to {FASTEST_MPS} m/s", -FASTEST_MPS),
            ));
        }
        Ok(WindField(Arc::new(Grid { origin_m, spacing_m, counts, velocity_mps })))
    }

    /// Returns whether the air moves up and down alone.
    pub fn is_vertical(&self) -> bool {
        self.0.velocity_mps.iter().all(|[x_mps, y_mps, _]| *x_mps == 0.0 && *y_mps == 0.0)
    }

    /// The velocity of the air at a place.
    pub fn velocity_mps(&self, pos_m: [f64; 3]) -> [f64; 3] {
        let Grid { origin_m, spacing_m, counts, velocity_mps } = &*self.0;
        let strides = [counts[1] * counts[2], counts[2], 1];
        // the first corner of the cell that holds the place, the way to the next one, and how far between
        let (mut first, mut next, mut share) = (0, [0; 3], [0.0; 3]);
        for axis in 0..3 {
            let last = (counts[axis] - 1) as f64;
            let place = ((pos_m[axis] - origin_m[axis]) / spacing_m[axis]).clamp(0.0, last);
            let cell = (place as usize).min(counts[axis].saturating_sub(2));
            first += cell * strides[axis];
            next[axis] = if counts[axis] > 1 { strides[axis] } else { 0 };
            share[axis] = place - cell as f64;
        }
        let corner = |i: usize| tabulate::<f64, 3>(|k| f64::from(velocity_mps[i][k]));
        let between = |axis: usize, low: [f64; 3], high: [f64; 3]| {
            tabulate::<f64, 3>(|k| low[k] + share[axis] * (high[k] - low[k]))
        };
        let along_z = |i: usize| between(2, corner(i), corner(i + next[2]));
        let along_y = |i: usize| between(1, along_z(i), along_z(i + next[1]));
        between(0, along_y(first), along_y(first + next[0]))
    }
}

impl TryFrom<WindTable> for WindField {
    type Error = Error;
    fn try_from(table: WindTable) -> Result<Self> {
        let WindTable { origin_m, spacing_m, velocity_mps: columns } = table;
        let rows = columns.first().map_or(0, Vec::len);
        let along_z = columns.first().and_then(|rows| rows.first()).map_or(0, Vec::len);
        let uneven = |what: &str, want: usize, got: usize| {
            Error::Config(format!(
                "wind_field: velocity_mps{what} has {got} entries, expected {want} as the first"
            ))
        };
        for (x, column) in columns.iter().enumerate() {
            if column.len() != rows {
                return Err(uneven(&format!("[{x}]"), rows, column.len()));
            }
            if let Some(y) = column.iter().position(|row| row.len() != along_z) {
                return Err(uneven(&format!("[{x}][{y}]"), along_z, column[y].len()));
            }
        }
        let counts = [columns.len(), rows, along_z];
        WindField::new(origin_m, spacing_m, counts, columns.into_iter().flatten().flatten().collect())
    }
}

impl From<WindField> for WindTable {
    fn from(field: WindField) -> Self {
        let Grid { origin_m, spacing_m, counts: [_, along_y, along_z], velocity_mps } = &*field.0;
        let column = |points: &[[f32; 3]]| points.chunks(*along_z).map(<[_]>::to_vec).collect();
        let columns = velocity_mps.chunks(along_y * along_z).map(column).collect();
        WindTable { origin_m: *origin_m, spacing_m: *spacing_m, velocity_mps: columns }
    }
}
