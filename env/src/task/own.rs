//! A mission of one's own: each drone has a track, gates, or a place beside another drone, and a load may hang below.

use std::ops::Range;

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use serde::Deserialize;
use serde_json::{Value, json};

use super::hover::ROOM;
use super::options::Rows;
use super::race::Race;
use super::track::Track;
use super::{
    Chosen, GOAL, Outcome, Outline, Scene, Situation, Start, Task, build, distance, keeping, on_circle,
    options, start_at,
};
use crate::coupling::load::Load;
use crate::error::{Error, Result, check_range, out_of_range};
use crate::model::VEHICLE_RADIUS_M;
use crate::number::{Bounds, Number};
use crate::observation::{Setpoint, Surroundings};
use crate::scalar::{Scalar, tabulate};

options! {
    fixed roles: Rows = Rows, "", (), "for each drone track, race or beside, with offset_m of its set-point and its start_m";
    fixed load_kg: f64 = 0.0, "kg", [0.0, 1.0], "mass of a load below them; 0 for none";
    fixed rope_m: f64 = 0.6, "m", [0.1, 1.5], "length of each rope";
}

/// Radius of the circle on which they fly by default.
const CIRCLE_M: f64 = 1.5;

pub struct Own {
    drones: Vec<Drone>,
    /// Drones in the order of their starts.
    order: Vec<usize>,
    board: usize,
    load: Option<Load>,
}

/// A drone's role as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Role {
    track: Option<Value>,
    race: Option<Value>,
    beside: Option<usize>,
    #[serde(default)]
    offset_m: [f64; 3],
    start_m: Option<[Number; 3]>,
}

struct Drone {
    part: Part,
    offset_m: [f64; 3],
    start_m: Option<[Number; 3]>,
    /// Its numbers on the board.
    board: Range<usize>,
}

enum Part {
    Track(Track),
    Race(Race),
    Beside(usize),
}

impl Task for Own {
    const NAME: &'static str = "own";
    const ID: &'static str = "CrazyflieOwn-v0";
    const ABOUT: &'static str = "A mission of your own: each drone has a track, gates or a place beside another; a load may hang below";
    const REWARD: &'static str = "that of track or race; ends and -10 as for formation";
    const MAX_EPISODE_STEPS: u32 = 1000;
    const DRONES: usize = 3;
    const SURROUNDED: bool = true;
    type Options = Options;

    fn new(chosen: Chosen<Options>, drones: usize) -> Result<Self> {
        let (o, mut roles) = (chosen.first(), chosen.list::<Role>("roles")?);
        if roles.is_empty() {
            roles = (0..drones).map(|i| Role::eight(on_circle(i, drones, CIRCLE_M, 0.0))).collect();
        }
        if roles.len() != drones {
            return Err(out_of_range(
                "the number of roles",
                roles.len() as f64,
                format!("{drones}: one for each of `drones`"),
            ));
        }
        let load = if o.load_kg > 0.0 { Some(Load::new(o.load_kg, o.rope_m, drones)?) } else { None };
        let mut own = Own { drones: Vec::new(), order: Vec::new(), board: 0, load };
        for (i, role) in roles.into_iter().enumerate() {
            let drone = role.read(own.board, drones).map_err(|error| in_role(i, &error))?;
            own.board = drone.board.end;
            own.drones.push(drone);
        }
        own.order = own.find_order()?;
        own.check_start()?;
        Ok(own)
    }

    fn board(&self) -> usize {
        self.board
    }

    fn load(&self) -> Option<Load> {
        self.load
    }

    fn start(&self, rng: &mut Pcg64Mcg, starts: &mut [Start], board: &mut [f64]) {
        for &i in &self.order {
            let drone = &self.drones[i];
            let board = &mut board[drone.board.clone()];
            match &drone.part {
                Part::Track(track) => track.start(rng, &mut starts[i..=i], board),
                Part::Race(race) => race.start(rng, &mut starts[i..=i], board),
                Part::Beside(leader) => starts[i] = start_at(starts[*leader].pos_m, &[]),
            }
            starts[i].pos_m.iter_mut().zip(drone.offset_m).for_each(|(p, offset)| *p += offset);
            if let Some(start_m) = &drone.start_m {
                let pos_m = [0, 1, 2].map(|i| start_m[i].draw(rng).clamp(ROOM[i][0], ROOM[i][1]));
                starts[i] = match drone.part {
                    Part::Race(_) => Race::start_from(pos_m),
                    _ => Start { pos_m, ..starts[i] },
                };
            }
        }
    }

    fn outlines(&self, board: &[f64]) -> Vec<Outline> {
        let outlines = |drone: &Drone| match &drone.part {
            Part::Race(race) => race.outlines(&board[drone.board.clone()]),
            _ => Vec::new(),
        };
        self.drones.iter().flat_map(outlines).collect()
    }

    #[inline(always)]
    fn setpoint<R: Scalar>(&self, own: usize, goal: &mut [R; GOAL], scene: &Scene<R>) -> Setpoint<R> {
        let drone = &self.drones[own];
        let setpoint = match &drone.part {
            Part::Track(track) => track.setpoint(own, goal, scene),
            Part::Race(race) => {
                return race.setpoint(own, goal, &Scene { board: drone.numbers(scene.board), ..*scene });
            }
            Part::Beside(leader) => Setpoint { pos_m: scene.drones[*leader].pos_m, yaw_rad: R::zero() },
        };
        let pos_m = tabulate(
            #[inline(always)]
            |i| setpoint.pos_m[i] + R::from_f64(drone.offset_m[i]),
        );
        Setpoint { pos_m, ..setpoint }
    }

    #[inline(always)]
    fn surroundings<R: Scalar>(
        &self,
        own: usize,
        pos_m: &[R; 3],
        goal: &[R; GOAL],
        board: &[R],
    ) -> Surroundings<R> {
        let drone = &self.drones[own];
        match &drone.part {
            Part::Race(race) => race.surroundings(own, pos_m, goal, drone.numbers(board)),
            _ => Surroundings::none(),
        }
    }

    #[inline(always)]
    fn judge<R: Scalar>(&self, own: usize, s: &Situation<R>, scene: &Scene<R>) -> Outcome<R> {
        match &self.drones[own].part {
            Part::Race(race) => race.judge(own, s, scene),
            _ => keeping(s),
        }
    }
}

impl Own {
    /// Orders the drones so that each comes after the one beside which it stays.
    ///
    /// # Errors
    /// [`Error::Config`] for drones that wait for each other.
    fn find_order(&self) -> Result<Vec<usize>> {
        let mut order = Vec::new();
        while order.len() < self.drones.len() {
            let ready = |i: &usize| match self.drones[*i].part {
                Part::Beside(leader) => order.contains(&leader),
                _ => true,
            };
            let (next, late): (Vec<_>, Vec<_>) =
                (0..self.drones.len()).filter(|i| !order.contains(i)).partition(ready);
            if next.is_empty() {
                let what = "it stays beside drones that stay beside each other in a circle, expected one that flies by itself";
                return Err(in_role(late[0], &Error::Config(what.into())));
            }
            order.extend(next);
        }
        Ok(order)
    }

    /// A drawn start is in the room, apart from the others, and within the reach of its rope.
    ///
    /// # Errors
    /// [`Error::Config`] naming the role.
    fn check_start(&self) -> Result<()> {
        let mut starts = vec![Start::origin(); self.drones.len()];
        self.start(&mut Pcg64Mcg::seed_from_u64(0), &mut starts, &mut vec![0.0; self.board]);
        let places: Vec<[f64; 3]> = starts.iter().map(|start| start.pos_m).collect();
        let check = |i: usize| {
            for (p, [low, high]) in places[i].iter().zip(ROOM) {
                check_range("a coordinate of its start", *p, low, high)?;
            }
            for (j, other) in places[..i].iter().enumerate() {
                check_range(
                    &format!("the distance of its start from that of roles[{j}]"),
                    distance(&places[i], other),
                    2.0 * VEHICLE_RADIUS_M,
                    f64::INFINITY,
                )?;
            }
            let Some(load) = &self.load else { return Ok(0.0) };
            let from_load_m = distance(&places[i], &load.hangs(places.iter().copied()));
            check_range("the distance of its start from the load", from_load_m, 0.0, 1.05 * load.rope_m)
        };
        (0..places.len()).try_for_each(|i| check(i).map(drop).map_err(|error| in_role(i, &error)))
    }
}

impl Role {
    /// The figure eight of the task `track`, about a place of its own.
    fn eight([x, y]: [f64; 2]) -> Self {
        Role { track: Some(json!({})), race: None, beside: None, offset_m: [x, y, 0.0], start_m: None }
    }

    /// The role of a drone of so many, whose numbers on the board begin at `first`.
    ///
    /// # Errors
    /// [`Error::Config`] and [`Error::Range`] for what cannot be flown.
    fn read(self, first: usize, drones: usize) -> Result<Drone> {
        let Role { offset_m, start_m, .. } = self;
        let shift_m = distance(&offset_m, &[0.0; 3]);
        let part = match (self.track, self.race, self.beside) {
            (Some(options), None, None) => Part::Track(build(&options, 1)?),
            (None, Some(options), None) => {
                check_range("the length of offset_m of a race", shift_m, 0.0, 0.0)?;
                Part::Race(build(&options, 1)?)
            }
            (None, None, Some(leader)) => {
                check_range("beside", leader as f64, 0.0, (drones - 1) as f64)?;
                check_range("the length of offset_m", shift_m, 2.0 * VEHICLE_RADIUS_M, 5.0)?;
                Part::Beside(leader)
            }
            _ => return Err(Error::Config("expected one of track, race and beside".into())),
        };
        for (number, [low, high]) in start_m.iter().flatten().zip(ROOM) {
            number.check(&Bounds { name: "start_m".into(), unit: "m", low, high })?;
        }
        let numbers = if let Part::Race(race) = &part { race.board() } else { 0 };
        Ok(Drone { part, offset_m, start_m, board: first..first + numbers })
    }
}

impl Drone {
    #[inline(always)]
    fn numbers<'a, R>(&self, board: &'a [R]) -> &'a [R] {
        board.get(self.board.clone()).unwrap_or_default()
    }
}

/// An error of a role, with its place.
fn in_role(i: usize, error: &Error) -> Error {
    let text = if let Error::Config(text) = error { text.clone() } else { error.to_string() };
    Error::Config(format!("options of the task own: roles[{i}]: {text}"))
}

#[cfg(test)]
mod tests {
    use crate::task::setpoints;

    use super::*;

    fn points(options: &Value, drone: usize, drones: usize) -> Result<Vec<[f64; 4]>> {
        setpoints("own", options, 0.02, 500, 7, Some((drone, drones)))
    }

    #[test]
    fn a_track_has_the_set_points_of_the_task_track() {
        for track in [
            json!({}),
            json!({"shape": "helix", "size_m": 0.8, "period_s": 5.0}),
            json!({"shape": "waypoints", "period_s": 1.0}),
            json!({"points": [[0, 0, 0, 0.7, 0], [3, 1, 0.5, 1.2, 1], [6, -1, 0.5, 0.9, 3]]}),
        ] {
            let alone = setpoints("track", &track, 0.02, 500, 7, None).unwrap();
            let options = json!({"roles": [{"track": track}, {"track": track, "offset_m": [0.5, 0, 0.25]}]});
            assert_eq!(points(&options, 0, 2).unwrap(), alone, "{track}");
            let shifted = points(&options, 1, 2).unwrap();
            let off = |(a, b): (&[f64; 4], &[f64; 4])| {
                (a[0] + 0.5 - b[0]).abs().max((a[1] - b[1]).abs()).max((a[2] + 0.25 - b[2]).abs())
            };
            let most_m = alone.iter().zip(&shifted).map(off).fold(0.0, f64::max);
            // waypoints are drawn for each drone
            assert_eq!(most_m < 1e-6, track["shape"] != "waypoints", "{track}: {most_m}");
        }
    }

    #[test]
    fn drones_fly_apart_by_default() {
        for drones in [1, 3, 64] {
            let first = points(&Value::Null, 0, drones).unwrap();
            assert!(first.iter().all(|[_, _, z, yaw]| (*z - 0.7).abs() < 1e-6 && *yaw == 0.0));
        }
    }

    #[test]
    fn mistakes_are_named_with_their_place() {
        let (eight, aside) = (json!({"track": {}}), json!({"track": {}, "offset_m": [0, 1, 0]}));
        let beside = |drone: usize| json!({"beside": drone, "offset_m": [0.5, 0, 0]});
        for (roles, words) in [
            (json!([eight]), "the number of roles is 1, expected 2: one for each of `drones`"),
            (json!([eight, eight]), "roles[1]: the distance of its start from that of roles[0] is 0"),
            (json!([eight, {"follow": {}}]), "unknown field `follow`"),
            (json!([eight, {}]), "roles[1]: expected one of track, race and beside"),
            (json!([eight, {"track": {}, "race": {}}]), "roles[1]: expected one of"),
            (json!([eight, {"track": {"sizem": 1}}]), "did you mean \"track.size_m\""),
            (json!([{"track": {"points": [[0, 0, 0]]}}, aside]), "roles[0]: points[0] has 3 numbers"),
            (json!([eight, {"race": {"level": 9}}]), "roles[1]: level is 9"),
            (
                json!([eight, {"race": {}, "offset_m": [1, 0, 0]}]),
                "roles[1]: the length of offset_m of a race",
            ),
            (json!([eight, beside(2)]), "roles[1]: beside is 2, expected 0 to 1"),
            (json!([eight, {"beside": 0}]), "roles[1]: the length of offset_m is 0"),
            (json!([beside(1), beside(0)]), "roles[0]: it stays beside drones that stay beside each other"),
            (json!([beside(0), eight]), "roles[0]: it stays beside"),
            (
                json!([eight, {"track": {}, "offset_m": [3, 0, 0]}]),
                "roles[1]: a coordinate of its start is 3",
            ),
            (json!([eight, {"track": {}, "start_m": [0, 0, 9]}]), "roles[1]: start_m is 9"),
        ] {
            let error = points(&json!({"roles": roles}), 0, 2).unwrap_err().to_string();
            assert!(error.contains(words), "{roles} gave: {error}");
        }
        let loaded = |kg: f64| {
            points(&json!({"roles": [eight, {"track": {}, "offset_m": [0, 1.5, 0]}], "load_kg": kg}), 0, 2)
                .map(drop)
        };
        for (kg, words) in
            [(0.01, "roles[0]: the distance of its start from the load"), (0.05, "load_kg is 0.05")]
        {
            let error = loaded(kg).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
