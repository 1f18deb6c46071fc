//! The high-level commander: take off, land, go to, trajectories. Paths are planned here and followed by the
//! cascade.

use crate::packet::Fields;
use crate::polynomial::{Path, PathPoint, Piece, Point};
use crate::trajectory_memory::TrajectoryMemory;

/// A request of the high-level commander, with what it needs of the memory.
#[derive(Debug, Clone)]
pub(crate) enum HighLevelCommand {
    /// To a height, and to a heading unless the present one stays.
    Climb {
        height_m: f64,
        yaw_rad: Option<f64>,
        pace: Pace,
        lands: bool,
    },
    Stop,
    GoTo {
        to: Point,
        relative: bool,
        linear: bool,
        duration_s: f64,
    },
    Spiral(Spiral),
    Fly {
        pieces: Vec<Piece>,
        time_scale: f64,
        relative: bool,
        turned: bool,
        reversed: bool,
    },
}

impl HighLevelCommand {
    /// Returns whether it wants a vehicle that flies.
    pub(crate) fn flies(&self) -> bool {
        !matches!(self, HighLevelCommand::Stop | HighLevelCommand::Climb { lands: true, .. })
    }
}

/// Pace of a change of height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Pace {
    Seconds(f64),
    /// Mean speed; none for the parameter's.
    Speed(Option<f64>),
}

/// A part of a spiral about a centre beside the vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Spiral {
    angle_rad: f64,
    radii_m: [f64; 2],
    ascent_m: f64,
    duration_s: f64,
    sideways: bool,
    clockwise: bool,
}

/// Errors as the firmware numbers them.
const ENOENT: u8 = 2;
const ENOEXEC: u8 = 8;

/// The answer, and the resulting command.
pub(crate) struct HighLevelReply {
    pub status: u8,
    pub command: Option<HighLevelCommand>,
}

/// A request, for a drone of the groups of `mask`. The memory learns of trajectories; nothing for what is too
/// short.
pub(crate) fn read_request(
    request: &[u8],
    mask: &mut u8,
    memory: &mut TrajectoryMemory,
) -> Option<HighLevelReply> {
    let mut fields = Fields(request);
    let kind = fields.u8()?;
    let done = |status: u8| Some(HighLevelReply { status, command: None });
    match kind {
        0 => {
            *mask = fields.u8()?;
            return done(0);
        }
        6 => return done(if memory.define(fields)? { 0 } else { ENOEXEC }),
        _ => {}
    }
    let group = fields.u8()?;
    let command = match kind {
        1 | 2 => climb(fields.f32()?, None, Pace::Seconds(fields.f32()?), kind == 2),
        3 => HighLevelCommand::Stop,
        4 | 12 => {
            let relative = fields.bool()?;
            let linear = kind == 12 && fields.bool()?;
            HighLevelCommand::GoTo { to: fields.f32s()?, relative, linear, duration_s: fields.f32()? }
        }
        5 | 13 => {
            let relative = fields.bool()?;
            let turned = kind == 13 && fields.bool()?;
            let (reversed, id, time_scale) = (fields.bool()?, fields.u8()?, fields.f32()?);
            let Some(pieces) = memory.pieces(id) else { return done(ENOENT) };
            HighLevelCommand::Fly { pieces, time_scale, relative, turned, reversed }
        }
        7 | 8 => {
            let (height_m, yaw_rad, keeps_yaw) = (fields.f32()?, fields.f32()?, fields.bool()?);
            climb(height_m, (!keeps_yaw).then_some(yaw_rad), Pace::Seconds(fields.f32()?), kind == 8)
        }
        9 | 10 => {
            let (height_m, relative) = (fields.f32()?, fields.bool()?);
            let (yaw_rad, keeps_yaw, speed_mps) = (fields.f32()?, fields.bool()?, fields.f32()?);
            if relative {
                return done(ENOEXEC);
            }
            let speed = (speed_mps > 0.0).then_some(speed_mps);
            climb(height_m, (!keeps_yaw).then_some(yaw_rad), Pace::Speed(speed), kind == 10)
        }
        11 => {
            let (sideways, clockwise) = (fields.bool()?, fields.bool()?);
            let [angle_rad, r0_m, r1_m, ascent_m, duration_s] = fields.f32s()?;
            let radii_m = [r0_m.max(0.0), r1_m.max(0.0)];
            HighLevelCommand::Spiral(Spiral { angle_rad, radii_m, ascent_m, duration_s, sideways, clockwise })
        }
        _ => return done(ENOEXEC),
    };
    // group 0 is everybody
    let ours = group == 0 || group & *mask != 0;
    Some(HighLevelReply { status: 0, command: ours.then_some(command) })
}

fn climb(height_m: f64, yaw_rad: Option<f64>, pace: Pace, lands: bool) -> HighLevelCommand {
    HighLevelCommand::Climb { height_m, yaw_rad, pace, lands }
}

/// Shortest time of a plan: a request for less is one for this.
const SHORTEST_S: f64 = 0.1;

#[derive(Debug, Clone)]
enum Way {
    Path(Path),
    Spiral { spiral: Spiral, from: Point },
}

impl Way {
    fn point(&self, t_s: f64) -> PathPoint {
        match self {
            Way::Path(path) => path.point(t_s),
            Way::Spiral { spiral, from } => spiral.point(from, t_s),
        }
    }

    fn duration_s(&self) -> f64 {
        match self {
            Way::Path(path) => path.duration_s(),
            Way::Spiral { spiral, .. } => spiral.duration_s,
        }
    }
}

impl Spiral {
    /// Radius and angle grow evenly. The centre lies to the left, or to the right if clockwise; sideways the
    /// nose looks at it, or else along the way.
    fn point(&self, from: &Point, t_s: f64) -> PathPoint {
        let share = (t_s / self.duration_s).clamp(0.0, 1.0);
        let [r0, r1] = self.radii_m;
        let (side, yaw0) = (if self.clockwise { -1.0 } else { 1.0 }, from[3]);
        // direction from the centre to the vehicle
        let out0 = if self.sideways {
            yaw0 + std::f64::consts::PI
        } else {
            yaw0 - side * std::f64::consts::FRAC_PI_2
        };
        let (turn, r) = (side * self.angle_rad, r0 + (r1 - r0) * share);
        let out = out0 + turn * share;
        let at = [
            from[0] - r0 * out0.cos() + r * out.cos(),
            from[1] - r0 * out0.sin() + r * out.sin(),
            from[2] + self.ascent_m * share,
            yaw0 + turn * share,
        ];
        let (dr, dout) = ((r1 - r0) / self.duration_s, turn / self.duration_s);
        let rate = [
            dr * out.cos() - r * dout * out.sin(),
            dr * out.sin() + r * dout * out.cos(),
            self.ascent_m / self.duration_s,
            dout,
        ];
        PathPoint { at, rate: if share < 1.0 { rate } else { [0.0; 4] } }
    }
}

#[derive(Debug, Clone)]
struct Plan {
    way: Way,
    since_s: f64,
    /// The motors stop at its end.
    lands: bool,
}

/// State of the high-level commander.
#[derive(Debug, Clone, Default)]
pub(crate) struct Planner {
    plan: Option<Plan>,
    /// A plan was made and has ended.
    finished: bool,
}

impl Planner {
    pub(crate) fn is_active(&self) -> bool {
        self.plan.is_some()
    }

    pub(crate) fn is_finished(&self) -> bool {
        self.finished
    }

    pub(crate) fn stop(&mut self) {
        self.plan = None;
    }

    /// Makes a plan from where the drone is to be now, or is while nothing is planned. `speeds_mps` are the
    /// parameters of take-off and landing.
    pub(crate) fn obey(&mut self, command: HighLevelCommand, now: &PathPoint, speeds_mps: [f64; 2]) {
        let from = self.plan.as_ref().map_or(*now, |plan| plan.way.point(plan.since_s));
        let (way, lands) = match command {
            HighLevelCommand::Stop => {
                self.plan = None;
                return;
            }
            HighLevelCommand::Climb { height_m, yaw_rad, pace, lands } => {
                let [x, y, z, yaw] = from.at;
                let to = [x, y, height_m, yaw_rad.map_or(yaw, |to| nearest_turn(yaw, to))];
                let duration_s = match pace {
                    Pace::Seconds(seconds) => seconds,
                    Pace::Speed(speed) => {
                        let usual = speeds_mps[usize::from(lands)].max(0.05);
                        (height_m - z).abs() / speed.unwrap_or(usual)
                    }
                };
                (smooth(&from, to, duration_s), lands)
            }
            HighLevelCommand::GoTo { to, relative, linear, duration_s } => {
                let to = if relative { std::array::from_fn(|i| from.at[i] + to[i]) } else { to };
                let to = [to[0], to[1], to[2], nearest_turn(from.at[3], to[3])];
                let duration_s = duration_s.max(SHORTEST_S);
                let straight = || Way::Path(Path::new(Piece::straight(&from, &to, duration_s)));
                (if linear { straight() } else { smooth(&from, to, duration_s) }, false)
            }
            HighLevelCommand::Spiral(spiral) => {
                let spiral = Spiral { duration_s: spiral.duration_s.max(SHORTEST_S), ..spiral };
                (Way::Spiral { spiral, from: from.at }, false)
            }
            HighLevelCommand::Fly { pieces, time_scale, relative, turned, reversed } => {
                let Some(mut path) = Path::trajectory(pieces, time_scale, reversed) else { return };
                if relative {
                    path.begin_at(&from.at, turned);
                }
                (Way::Path(path), false)
            }
        };
        self.plan = Some(Plan { way, since_s: 0.0, lands });
        self.finished = false;
    }

    /// A tick on; where the drone is to be. At its end a plan keeps its place, or stops the motors.
    pub(crate) fn tick(&mut self, tick_s: f64) -> Option<PathPoint> {
        let plan = self.plan.as_mut()?;
        plan.since_s += tick_s;
        let point = plan.way.point(plan.since_s);
        if plan.since_s >= plan.way.duration_s() {
            self.finished = true;
            if plan.lands {
                self.plan = None;
                return None;
            }
        }
        Some(point)
    }
}

fn smooth(from: &PathPoint, to: Point, duration_s: f64) -> Way {
    Way::Path(Path::new(Piece::smooth(from, &to, duration_s.max(SHORTEST_S))))
}

/// A heading as many whole turns on that it is the nearest.
fn nearest_turn(from_rad: f64, to_rad: f64) -> f64 {
    from_rad + crazyflie_env::scalar::wrap(to_rad - from_rad)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const GROUND: PathPoint = PathPoint { at: [1.0, 2.0, 0.0, 0.0], rate: [0.0; 4] };

    fn take_off() -> Planner {
        let mut planner = Planner::default();
        planner.obey(climb(0.5, None, Pace::Seconds(1.0), false), &GROUND, [0.5; 2]);
        planner
    }

    fn after(planner: &mut Planner, seconds: f64) -> Option<PathPoint> {
        let mut point = None;
        for _ in 0..(seconds / 0.01).round() as usize {
            point = planner.tick(0.01);
        }
        point
    }

    #[test]
    fn a_take_off_holds_and_a_landing_ends() {
        let mut planner = take_off();
        assert_eq!(after(&mut planner, 1.5).unwrap().at, [1.0, 2.0, 0.5, 0.0]);
        assert!(planner.is_finished() && planner.is_active());
        planner.obey(climb(0.0, None, Pace::Speed(None), true), &GROUND, [0.5; 2]);
        assert!(after(&mut planner, 0.5).is_some() && after(&mut planner, 0.6).is_none());
        assert!(!planner.is_active());
    }

    #[test]
    fn going_is_relative_to_the_plan_and_turns_the_short_way() {
        let mut planner = take_off();
        after(&mut planner, 2.0);
        let to = [1.0, 0.0, 0.0, 6.0];
        let go = HighLevelCommand::GoTo { to, relative: true, linear: true, duration_s: 1.0 };
        planner.obey(go, &GROUND, [0.5; 2]);
        let half = after(&mut planner, 0.5).unwrap();
        assert!((half.at[0] - 1.5).abs() < 1e-9 && (half.at[3] + 0.1416).abs() < 1e-4, "{half:?}");
    }

    #[test]
    fn a_spiral_begins_where_the_drone_is_and_ends_a_turn_on() {
        let spiral = Spiral {
            angle_rad: std::f64::consts::PI,
            radii_m: [1.0, 2.0],
            ascent_m: 0.3,
            duration_s: 2.0,
            sideways: false,
            clockwise: false,
        };
        let from = [0.0, 0.0, 1.0, 0.0];
        assert!(spiral.point(&from, 0.0).at.iter().zip(from).all(|(a, b)| (a - b).abs() < 1e-12));
        let end = spiral.point(&from, 2.0).at;
        // the centre is a metre to the left, the end two metres beyond it
        assert!(end[0].abs() < 1e-9 && (end[1] - 3.0).abs() < 1e-9 && (end[2] - 1.3).abs() < 1e-9, "{end:?}");
        assert!(spiral.point(&from, 0.01).rate[0] > 0.0, "the nose leads");
    }

    #[test]
    fn groups_that_are_not_ours_are_not_obeyed() {
        let (mut mask, mut memory) = (0, TrajectoryMemory::new());
        assert_eq!(read_request(&[0, 2], &mut mask, &mut memory).unwrap().status, 0);
        assert_eq!(mask, 2);
        for (group, ours) in [(0, true), (2, true), (3, true), (4, false)] {
            let understood = read_request(&[3, group], &mut mask, &mut memory).unwrap();
            assert_eq!(understood.command.is_some(), ours);
        }
        let unknown = read_request(&[13, 0, 0, 0, 0, 9, 0, 0, 128, 63], &mut mask, &mut memory).unwrap();
        assert_eq!(unknown.status, ENOENT);
    }

    proptest! {
        #[test]
        fn every_request_is_answered_or_ignored(
            request in proptest::collection::vec(any::<u8>(), 0..31), ticks in 0_u8..50
        ) {
            let (mut mask, mut memory, mut planner) = (0, TrajectoryMemory::new(), Planner::default());
            if let Some(HighLevelReply { command: Some(command), .. }) = read_request(&request, &mut mask, &mut memory) {
                planner.obey(command, &GROUND, [0.5; 2]);
            }
            for _ in 0..ticks {
                planner.tick(0.01);
            }
        }
    }
}
