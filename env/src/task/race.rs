//! Race through gates, in order, and past obstacles.

mod course;

use rand_pcg::Pcg64Mcg;

use super::options::Rows;
use super::{
    Chosen, GOAL, Outcome, Outline, Scene, Situation, Start, Task, distance, is, jerk, jitter, keeping,
    options, start_at,
};
use crate::error::{Error, Result};
use crate::observation::{Setpoint, Surroundings};
use crate::scalar::{Scalar, tabulate};
use course::{Course, Gate};

options! {
    fixed level: usize = 1, "1", [1.0, 4.0], "1: four gates on a circle; 2: moved and turned in every episode; 3: smaller, with poles; 4: at different heights, with boxes";
    fixed laps: usize = 1, "1", [1.0, 20.0], "rounds to fly";
    fixed opening_m: f64 = 0.6, "m", [0.3, 2.0], "inner width and height of a gate; 0.45 m from level 3 on";
    fixed pace_mps: f64 = 0.5, "m/s", [0.05, 5.0], "speed of the set-point, which waits for the drone before each gate";
    fixed shift_m: f64 = 0.0, "m", [0.0, 0.5], "most that an episode moves gates and obstacles along each axis; 0.2 m from level 2 on";
    fixed turn_rad: f64 = 0.0, "rad", [0.0, 1.0], "most that an episode turns each gate; 0.35 rad from level 2 on";
    fixed gates: Rows = Rows, "", (), "gates of one's own: rows of x_m, y_m, z_m of the middle, and yaw_rad of the direction to fly";
    fixed poles: Rows = Rows, "", (), "poles from the floor to the ceiling: rows of x_m, y_m, radius_m";
    fixed boxes: Rows = Rows, "", (), "boxes along the room's axes: rows of x_m, y_m, z_m of the middle and the three sizes";
}

pub struct Race {
    course: Course,
    laps: usize,
    shift_m: f64,
    turn_rad: f64,
    pace_mps: f64,
}

/// Goal slots: where the drone was a tick ago, gates passed since the start, ...
const LAST: usize = 0;
const PASSED: usize = 3;
/// ... 0 on the way to the point before the gate, 1 from there on, 2 once it is passed, to the point behind, ...
const LEG: usize = 4;
/// ... and of this tick: metres nearer to the gate, gates passed, 1 for a hit.
const PROGRESS: usize = 5;
const PASSES: usize = 6;
const HIT: usize = 7;
/// Index of the set-point and of its time.
const SETPOINT: usize = 8;
const SINCE: usize = 11;

/// The set-point is this far before a gate, then this far behind it.
const LEAD_M: f64 = 0.4;
/// Near enough to the point before the gate.
const NEAR_M: f64 = 0.12;
/// The start lies this far before the first gate.
const RUN_UP_M: f64 = 0.8;

impl Task for Race {
    const NAME: &'static str = "race";
    const ID: &'static str = "CrazyflieRace-v0";
    const ABOUT: &'static str = "Fly through gates in order, past poles and boxes, as fast as possible";
    const REWARD: &'static str = "4 for each metre nearer to the next gate, 5 for each gate, - 0.02 jerk per step; ends behind the last gate; -10 for touching a gate or an obstacle, a crash or leaving the room, which end it too";
    const MAX_EPISODE_STEPS: u32 = 1500;
    const CRASH_COST: f64 = 10.0;
    const SURROUNDED: bool = true;
    type Options = Options;

    fn new(mut chosen: Chosen<Options>, _: usize) -> Result<Self> {
        let level = chosen.first().level;
        let course = Course::read(&chosen)?;
        if chosen.gives("level") && !course.is_empty() {
            return Err(Error::Config(
                "options of the task race: a level is given, so gates, poles and boxes must not be".into(),
            ));
        }
        for (name, from, value) in [("shift_m", 2, 0.2), ("turn_rad", 2, 0.35), ("opening_m", 3, 0.45)] {
            if level >= from && !chosen.gives(name) {
                chosen.set(name, value);
            }
        }
        let o = chosen.first();
        let course = course.complete(level, o.opening_m);
        course.check(o.shift_m, RUN_UP_M)?;
        Ok(Race { course, laps: o.laps, shift_m: o.shift_m, turn_rad: o.turn_rad, pace_mps: o.pace_mps })
    }

    fn board(&self) -> usize {
        self.course.numbers()
    }

    fn start(&self, rng: &mut Pcg64Mcg, starts: &mut [Start], board: &mut [f64]) {
        let gate = self.course.draw(self.shift_m, self.turn_rad, rng, board);
        let [dx, dy, dz] = jitter(rng, 0.05);
        let [x, y, z, yaw_rad] = gate;
        let pos_m = [x - RUN_UP_M * libm::cos(yaw_rad) + dx, y - RUN_UP_M * libm::sin(yaw_rad) + dy, z + dz];
        starts.fill(Self::start_from(pos_m));
    }

    fn outlines(&self, board: &[f64]) -> Vec<Outline> {
        self.course.outlines(board)
    }

    #[inline(always)]
    fn setpoint<R: Scalar>(&self, own: usize, goal: &mut [R; GOAL], scene: &Scene<R>) -> Setpoint<R> {
        let drone = &scene.drones[own];
        let before_m = [goal[LAST], goal[LAST + 1], goal[LAST + 2]];
        // a drone that no longer flies keeps its place
        let now_m = tabulate(
            #[inline(always)]
            |i| R::select(R::zero().lt(drone.here), drone.pos_m[i], before_m[i]),
        );
        let gate = self.next_gate(goal, scene.board, 0.0);
        let nearer_m = gate.distance(&before_m) - gate.distance(&now_m);
        let passed = gate.is_passed(&before_m, &now_m, self.course.free_m());
        let hit = self.course.is_hit(scene.board, &before_m, &now_m);
        let one = R::from_f64(1.0);
        goal[PROGRESS] = nearer_m;
        goal[PASSES] = R::select(passed, one, R::zero());
        goal[HIT] = R::select(hit, one, R::zero());
        goal[PASSED] += goal[PASSES];
        goal[LAST..LAST + 3].copy_from_slice(&now_m);
        let (gate, last) = (self.next_gate(goal, scene.board, 0.0), self.next_gate(goal, scene.board, -1.0));
        let missed = R::from_f64(0.5 * LEAD_M).lt(gate.depth(&now_m)) & goal[LEG].lt(R::from_f64(1.5));
        goal[LEG] = R::select(missed, R::zero(), R::select(passed, R::from_f64(2.0), goal[LEG]));
        self.waypoint(goal, [&gate, &last], &now_m, scene.t_s)
    }

    #[inline(always)]
    fn judge<R: Scalar>(&self, _: usize, s: &Situation<R>, _: &Scene<R>) -> Outcome<R> {
        let all = R::from_f64(self.gates_to_pass() - 0.5);
        let (done, hit) = (s.goal[PASSED].gt(all), R::from_f64(0.5).lt(s.goal[HIT]));
        let cost = R::select(hit, R::from_f64(Self::CRASH_COST), R::zero());
        Outcome {
            reward: R::from_f64(4.0) * s.goal[PROGRESS] + R::from_f64(5.0) * s.goal[PASSES]
                - R::from_f64(0.02) * jerk(s)
                - cost,
            arrived: done,
            ends: done | hit,
            ..keeping(s)
        }
    }

    #[inline(always)]
    fn surroundings<R: Scalar>(
        &self,
        _: usize,
        pos_m: &[R; 3],
        goal: &[R; GOAL],
        board: &[R],
    ) -> Surroundings<R> {
        let (gate, next) = (self.next_gate(goal, board, 0.0), self.next_gate(goal, board, 1.0));
        Surroundings {
            gate_pos_m: gate.pos_m,
            gate_yaw_rad: gate.yaw_rad,
            next_gate_pos_m: next.pos_m,
            next_gate_yaw_rad: next.yaw_rad,
            obstacle_m: self.course.nearest_obstacle(board, pos_m),
        }
    }
}

impl Race {
    /// A start at a place of one's own.
    pub(super) fn start_from(pos_m: [f64; 3]) -> Start {
        let mut goal = [0.0; GOAL];
        goal[LAST..LAST + 3].copy_from_slice(&pos_m);
        goal[SETPOINT..SETPOINT + 3].copy_from_slice(&pos_m);
        start_at(pos_m, &goal)
    }

    fn gates_to_pass(&self) -> f64 {
        (self.laps * self.course.gates()) as f64
    }

    /// Returns the gate `ahead` gates after those that were passed; the first or the last one beyond them.
    #[inline(always)]
    fn next_gate<R: Scalar>(&self, goal: &[R; GOAL], board: &[R], ahead: f64) -> Gate<R> {
        let n = self.course.gates();
        let last = R::from_f64(self.gates_to_pass() - 1.0);
        let number = (goal[PASSED] + R::from_f64(ahead)).clamp(R::zero(), last);
        // half a gate keeps it on the right side of a whole round
        let rounds = ((number - R::from_f64(0.5 * (n as f64 - 1.0))) / R::from_f64(n as f64)).round();
        let place = number - R::from_f64(n as f64) * rounds;
        let mut gate = self.course.gate(board, 0);
        for i in 1..n {
            gate = gate.or_where(is(place, i), &self.course.gate(board, i));
        }
        gate
    }

    /// Returns the point before the gate; once the drone is there, a point through the gate; then one behind it
    /// before the next gate, so as not to cut across its frame.
    #[inline(always)]
    fn waypoint<R: Scalar>(
        &self,
        goal: &mut [R; GOAL],
        [next, last]: [&Gate<R>; 2],
        pos_m: &[R; 3],
        t_s: R,
    ) -> Setpoint<R> {
        let (one, zero, half) = (R::from_f64(1.0), R::zero(), R::from_f64(0.5));
        let from_m = [goal[SETPOINT], goal[SETPOINT + 1], goal[SETPOINT + 2]];
        let lead = R::from_f64(LEAD_M);
        let before_m = next.point(-lead);
        let done = one.lt(goal[LEG]) & distance(&from_m, &last.point(lead)).lt(R::from_f64(0.01));
        goal[LEG] = R::select(done, zero, goal[LEG]);
        let waits = goal[LEG].lt(half);
        let near = waits & distance(pos_m, &before_m).lt(R::from_f64(NEAR_M));
        goal[LEG] = R::select(near, one, goal[LEG]);
        let (ahead_m, behind_m) = (next.point(lead), last.point(lead));
        let to_m = tabulate(
            #[inline(always)]
            |i| {
                let on = R::select(one.lt(goal[LEG]), behind_m[i], ahead_m[i]);
                R::select(goal[LEG].lt(half), before_m[i], on)
            },
        );
        let stride_m = R::from_f64(self.pace_mps) * (t_s - goal[SINCE]);
        goal[SINCE] = t_s;
        // never more than what is left, and no division by nothing
        let share = stride_m / distance(&to_m, &from_m).max(stride_m).max(R::from_f64(1e-6));
        let moved_m = tabulate(
            #[inline(always)]
            |i| from_m[i] + share * (to_m[i] - from_m[i]),
        );
        goal[SETPOINT..SETPOINT + 3].copy_from_slice(&moved_m);
        // the direction to fly is the gate's, the heading stays
        Setpoint { pos_m: moved_m, yaw_rad: zero }
    }
}
