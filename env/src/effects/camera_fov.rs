//! The camera's field of view: markers leave the picture and return.

use super::{Call, Effect, Frame, Hooks, Observability, Param, param};
use crate::motors::Attitude;
use crate::plant::State;
use crate::scalar::{Scalar, dot, tabulate};

pub struct CameraFov;

impl Effect<5, 1> for CameraFov {
    const NAME: &'static str = "camera_fov";
    const ABOUT: &'static str =
        "Field of view: a marker is found only with all four corners in the picture, and near enough";
    const SOURCE: &'static str = "Thesis 3.1.2 (120 degrees, 720 x 480), 4.1.1 (lens 2 cm below the centre), marker of 197 mm; pinhole camera";
    const PARAMS: [Param; 5] = [
        param("diagonal_deg", "deg", 0.0, [0.0, 175.0])
            .about("view angle across the picture's diagonal; 120 for the thesis's camera, 0 for no limit"),
        param("lens_below_m", "m", 0.02, [0.0, 0.2]).about("lens below the centre of mass"),
        param("side_m", "m", 0.197, [0.01, 2.0]).about("side of a marker"),
        param("range_m", "m", 5.0, [0.1, 100.0]).about("farthest distance at which a marker is found"),
        param("reacquire_s", "s", 0.0, [0.0, 2.0])
            .about("time for which a lost marker must be in view again before it counts"),
    ];
    const HOOKS: Hooks = Hooks::FRAME;
    const OBSERVABILITY: Observability = Observability::Visibility;

    #[inline(always)]
    fn frame<R: Scalar>(cx: Call<R, 5>, wait: &mut [R; 1], f: &mut Frame<R>) {
        let &[diagonal_deg, _, _, _, reacquire_s] = cx.params;
        let limited = diagonal_deg.gt(R::zero());
        let (found, nearest_m) = look(cx.params, cx.x, &f.field);
        let lost = found.lt(R::from_f64(0.5));
        let waited = R::select(lost, reacquire_s, (wait[0] - R::from_f64(cx.h_s)).max(R::zero()));
        wait[0] = R::select(f.captured & limited, waited, wait[0]);
        let counted = R::select(wait[0].gt(R::zero()), R::zero(), found);
        f.markers = R::select(limited, counted, f.markers);
        for i in 0..2 {
            f.nearest_m[i] = R::select(limited, nearest_m[i], f.nearest_m[i]);
        }
    }
}

/// Returns the number of markers in view, and the place of the nearest of them.
#[inline(always)]
fn look<R: Scalar>(
    &[diagonal_deg, lens_below_m, side_m, range_m, _]: &[R; 5],
    x: &State<R>,
    &[columns, rows, pitch_m]: &[R; 3],
) -> (R, [R; 2]) {
    let half = (diagonal_deg * R::from_f64(0.5 * std::f64::consts::PI / 180.0)).tan();
    // 720 x 480 pixels: shares of the diagonal
    let (wide, high) = (half * R::from_f64(720.0 / 865.332_306), half * R::from_f64(480.0 / 865.332_306));
    let camera = Camera::new(x, lens_below_m);
    let (mut found, mut nearest, mut nearest_d2) = (R::zero(), [R::zero(); 2], R::from_f64(1e9));
    for column in 0..9 {
        let c = R::from_f64(f64::from(column));
        if !R::any(c.lt(columns)) {
            break;
        }
        for row in 0..9 {
            let r = R::from_f64(f64::from(row));
            let exists = c.lt(columns) & r.lt(rows);
            if !R::any(exists) {
                break;
            }
            let centre = [
                (c - R::from_f64(0.5) * (columns - R::from_f64(1.0))) * pitch_m,
                (r - R::from_f64(0.5) * (rows - R::from_f64(1.0))) * pitch_m,
            ];
            let mut seen = exists;
            for (sx, sy) in [(-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)] {
                let [u, v, depth] = camera
                    .project(centre[0] + R::from_f64(sx) * side_m, centre[1] + R::from_f64(sy) * side_m);
                seen = seen
                    & depth.gt(R::from_f64(1e-3))
                    & u.abs().lt(wide * depth)
                    & v.abs().lt(high * depth)
                    & depth.lt(range_m);
            }
            found = R::select(seen, found + R::from_f64(1.0), found);
            let (dx, dy) = (x.pos_m[0] - centre[0], x.pos_m[1] - centre[1]);
            let d2 = dx * dx + dy * dy;
            let nearer = seen & d2.lt(nearest_d2);
            nearest_d2 = R::select(nearer, d2, nearest_d2);
            for i in 0..2 {
                nearest[i] = R::select(nearer, centre[i], nearest[i]);
            }
        }
    }
    (found, nearest)
}

/// A camera that looks down along the body's -z.
struct Camera<R> {
    lens_m: [R; 3],
    /// Columns: the body axes in the world.
    rotation: [[R; 3]; 3],
}

impl<R: Scalar> Camera<R> {
    #[inline(always)]
    fn new(x: &State<R>, below_m: R) -> Self {
        let rotation = Attitude::new(x.att_rad).rotation();
        let lens_m = tabulate(
            #[inline(always)]
            |i| x.pos_m[i] - below_m * rotation[i][2],
        );
        Camera { lens_m, rotation }
    }

    /// A point of the floor in camera coordinates: along body x, along body y, depth.
    #[inline(always)]
    fn project(&self, x: R, y: R) -> [R; 3] {
        let d = [x - self.lens_m[0], y - self.lens_m[1], -self.lens_m[2]];
        let [a, b, c] = self.rotation;
        [dot(&[a[0], b[0], c[0]], d), dot(&[a[1], b[1], c[1]], d), -dot(&[a[2], b[2], c[2]], d)]
    }
}
