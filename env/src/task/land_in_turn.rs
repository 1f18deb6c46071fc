//! Land on one marker, one after another.

use rand_pcg::Pcg64Mcg;

use super::{
    Chosen, GOAL, Outcome, Scene, Situation, Start, Task, distance, is, jitter, landing_reward, on_circle,
    options, room_on_circle, start_at,
};
use crate::error::Result;
use crate::observation::Setpoint;
use crate::scalar::{Scalar, tabulate};

options! {
    drawn radius_m: f64 = 0.8, "m", [0.2, 2.2], "radius of the circle on which they wait";
    drawn height_m: f64 = 0.7, "m", [0.2, 2.5], "height of the circle";
    drawn speed_mps: f64 = 0.3, "m/s", [0.05, 2.0], "speed of the set-point of the one whose turn it is";
}

pub struct LandInTurn(Chosen<Options>);

/// Goal slots behind the own place on the circle: speed, one over the radius, the way to go before it sinks,
/// height, and how far it sinks.
const SPEED: usize = 2;
const PER_RADIUS: usize = 3;
const BEFORE: usize = 4;
const HEIGHT: usize = 5;
const DEPTH: usize = 6;

/// Board: whose turn it is, and since when.
const TURN: usize = 0;
const SINCE: usize = 1;

/// The package that the thesis flew cuts the motors here: that is a landing.
const CUT_M: f64 = 0.05;

impl Task for LandInTurn {
    const NAME: &'static str = "land_in_turn";
    const ID: &'static str = "CrazyflieLandInTurn-v0";
    const ABOUT: &'static str = "Drones wait on a circle and land on one marker, one after another: motors are cut 5 cm up, and who has landed is carried away";
    const REWARD: &'static str = "0.1 (closeness - 1) - 0.005 jerk per step; at touch-down once 10 / (1 + (off / 0.1 m)^2) / (1 + (impact / 0.3 m/s)^2); ends and -10 as for formation";
    const MAX_EPISODE_STEPS: u32 = 2000;
    const DRONES: usize = 4;
    type Options = Options;

    fn new(chosen: Chosen<Options>, drones: usize) -> Result<Self> {
        for o in chosen.corners() {
            // they start up to 5 cm off their places
            room_on_circle("radius_m", o.radius_m, drones, 0.25)?;
        }
        Ok(LandInTurn(chosen))
    }

    fn board(&self) -> usize {
        2
    }

    fn start(&self, rng: &mut Pcg64Mcg, starts: &mut [Start], board: &mut [f64]) {
        board.fill(0.0);
        let (o, n) = (self.0.draw(rng), starts.len());
        for (i, start) in starts.iter_mut().enumerate() {
            let [x, y] = on_circle(i, n, o.radius_m, 0.0);
            let [dx, dy] = jitter(rng, 0.05);
            *start = start_at(
                [x + dx, y + dy, o.height_m],
                // a second's way above the marker, then down into the floor, so that it is reached
                &[
                    x,
                    y,
                    o.speed_mps,
                    1.0 / o.radius_m,
                    o.radius_m + o.speed_mps,
                    o.height_m,
                    o.height_m + 0.1,
                ],
            );
        }
    }

    #[inline(always)]
    fn turn<R: Scalar>(&self, board: &mut [R], scene: &Scene<R>) {
        for (i, drone) in scene.drones.iter().enumerate() {
            let gone = is(board[TURN], i) & drone.here.le(R::zero());
            board[TURN] = R::select(gone, R::from_f64(i as f64 + 1.0), board[TURN]);
            board[SINCE] = R::select(gone, scene.t_s, board[SINCE]);
        }
    }

    #[inline(always)]
    fn setpoint<R: Scalar>(&self, own: usize, goal: &mut [R; GOAL], scene: &Scene<R>) -> Setpoint<R> {
        let mine = is(scene.board[TURN], own);
        let gone_m = (scene.t_s - scene.board[SINCE]) * goal[SPEED];
        let share = (gone_m * goal[PER_RADIUS]).clamp(R::zero(), R::from_f64(1.0));
        let inwards = R::select(mine, R::from_f64(1.0) - share, R::from_f64(1.0));
        let sunk = (gone_m - goal[BEFORE]).clamp(R::zero(), goal[DEPTH]);
        let height = goal[HEIGHT] - R::select(mine, sunk, R::zero());
        let [x, y] = tabulate(
            #[inline(always)]
            |i| inwards * goal[i],
        );
        Setpoint { pos_m: [x, y, height], yaw_rad: R::zero() }
    }

    #[inline(always)]
    fn judge<R: Scalar>(&self, own: usize, s: &Situation<R>, scene: &Scene<R>) -> Outcome<R> {
        let sinking_mps = s.contact.impact_mps.max(-s.x.vel_mps[2]);
        let had_its_turn = R::from_f64(own as f64 - 0.5).lt(scene.board[TURN]);
        let down = (s.contact.standing | s.x.pos_m[2].lt(R::from_f64(CUT_M))) & had_its_turn;
        let reward = landing_reward(s, sinking_mps, down);
        let error_m = distance(&s.x.pos_m, &s.setpoint.pos_m);
        Outcome { reward, error_m, arrived: down, ends: down }
    }
}
