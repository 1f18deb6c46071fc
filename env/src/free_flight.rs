//! Drones that share the air and obey commands, tick by tick, without a task: what simulated vehicles fly.

use rand_pcg::Pcg64Mcg;

use crate::action::{ACTION, Interface};
use crate::config::Options;
use crate::coupling::MOST_DRONES;
use crate::coupling::load::Load;
use crate::effects::Reading;
use crate::episode::{
    At, Commander, Drone, DroneResult, Episode, FlightPlan, Flights, SharedAir, Sight, Sink, Starts,
};
use crate::error::{Error, Result, check_range};
use crate::model::{Model, Schedule};
use crate::noise::episode_key;
use crate::observation::Setpoint;
use crate::plant::{Command, State};
use crate::scalar::Scalar;
use crate::task::{Chosen, GOAL, Outcome, Scene, Situation, Start, Task};
use crate::world::{Contact, World};

/// Drones in flight. A tick costs what one of an environment costs; call [`FreeFlight::tick`] once per control tick
/// of the model.
pub struct FreeFlight {
    episode: Episode<f64, Free, SharedAir<f64>>,
    drones: Vec<FreeDrone>,
}

/// A drone at the end of a tick.
#[derive(Debug, Clone, Copy)]
pub struct FreeDrone {
    /// The true state.
    pub state: State<f64>,
    /// Readings of its sensors.
    pub reading: Reading<f64>,
    /// Touch of the floor during the tick.
    pub contact: Contact<f64>,
    /// It is nearer to another drone than two radii.
    pub collided: bool,
}

/// A place for each drone, and a load below them.
#[derive(Debug, Clone)]
pub struct FreeStart {
    /// Places of the drones, at rest: in the air they hover.
    pub pos_m: Vec<[f64; 3]>,
    /// A load on ropes below them.
    pub load: Option<Load>,
    /// The noise is that of the first episode of this seed.
    pub seed: u64,
}

impl FreeFlight {
    /// Drones of a model with the effects, the radius and the vertical form of `options`.
    ///
    /// # Errors
    /// [`crate::Error::Unknown`], [`crate::Error::Range`] or [`crate::Error::Config`] for what cannot be flown.
    pub fn new(model: &Model, options: &Options, start: FreeStart) -> Result<Self> {
        let drones = start.pos_m.len();
        check_range("drones", drones as f64, 1.0, MOST_DRONES as f64)?;
        if options.wind_field.is_some() {
            return Err(Error::Config(
                "wind_field: a free flight does not have this option; leave it out".into(),
            ));
        }
        let input = options.action.input(model, options.vertical)?;
        let interfaces = vec![Interface::at_level(model, input, options.action)?; drones];
        let options = &Options { max_episode_steps: 0, ..options.clone() };
        let tick_s = Schedule::from_model(model)?.tick_s();
        let models = &vec![model; drones];
        let plan = FlightPlan { models, interfaces: &interfaces, options, tick_s, tiles: 1 };
        let (key, mut starts) = (episode_key(start.seed, 0), Starts::origin(drones, 0));
        let task = Free { pos_m: start.pos_m, load: start.load };
        let episode = Episode::new(task, plan, &mut |own, settings| {
            World::new(model, &options.drone_effects(own), settings, 1)
        })?;
        let mut flight = FreeFlight { episode, drones: Vec::new() };
        flight.episode.draw(0, 0, key, &mut starts);
        flight.episode.begin(0, true, &starts, &mut Notes { drones: &mut flight.drones });
        Ok(flight)
    }

    /// All drones obey for a tick.
    ///
    /// # Panics
    /// Unless there is a command for each drone.
    pub fn tick(&mut self, commands: &[Command<f64>]) {
        assert_eq!(commands.len(), self.drones.len(), "a command for each drone");
        self.episode.tick(0..1, commands, &mut Notes { drones: &mut self.drones });
    }

    /// The drones at the end of the last tick, or as they began.
    pub fn drones(&self) -> &[FreeDrone] {
        &self.drones
    }
}

/// Commands of the only tile, one for each drone.
impl Commander<f64> for [Command<f64>] {
    fn action(&self, _: usize, own: usize, drone: &Drone<f64>) -> [f64; ACTION] {
        drone.interface.action(&self[own])
    }

    fn command(&self, at: At, _: &mut Drone<f64>, _: &[f64; ACTION]) -> Command<f64> {
        self[at.own]
    }
}

/// Notes how the drones are.
struct Notes<'a> {
    drones: &'a mut Vec<FreeDrone>,
}

impl Sink<f64, SharedAir<f64>> for Notes<'_> {
    fn looks_around(&self) -> bool {
        false
    }

    fn begin(&mut self, at: At, _: bool, flights: &Flights<f64, SharedAir<f64>>, sight: &Sight<'_, f64>) {
        let contact = Contact { impact_mps: 0.0, standing: flights.state(0, at.own).pos_m[2] <= 0.0 };
        let (state, reading) = (*flights.state(0, at.own), *sight.reading);
        self.drones.push(FreeDrone { state, reading, contact, collided: false });
    }

    fn tick(
        &mut self,
        at: At,
        flights: &Flights<f64, SharedAir<f64>>,
        sight: &Sight<'_, f64>,
        result: &DroneResult<'_, f64>,
    ) {
        let (state, reading) = (*flights.state(0, at.own), *sight.reading);
        self.drones[at.own] = FreeDrone { state, reading, contact: result.contact, collided: result.hit };
    }
}

/// No task: it has no set-point, and nothing ends a flight.
struct Free {
    pos_m: Vec<[f64; 3]>,
    load: Option<Load>,
}

impl Task for Free {
    const NAME: &'static str = "free";
    const ID: &'static str = "";
    const ABOUT: &'static str = "Fly without a task";
    const REWARD: &'static str = "none";
    const MAX_EPISODE_STEPS: u32 = 0;
    const DRONES: usize = 2;
    const CRASH_COST: f64 = 0.0;
    const ENDS_FLIGHTS: bool = false;
    type Options = ();

    fn new(_: Chosen<()>, drones: usize) -> Result<Self> {
        Ok(Free { pos_m: vec![[0.0; 3]; drones], load: None })
    }

    fn load(&self) -> Option<Load> {
        self.load
    }

    fn start(&self, _: &mut Pcg64Mcg, starts: &mut [Start], _: &mut [f64]) {
        for (start, pos_m) in starts.iter_mut().zip(&self.pos_m) {
            *start = Start { pos_m: *pos_m, ..Start::origin() };
        }
    }

    fn setpoint<R: Scalar>(&self, _: usize, _: &mut [R; GOAL], _: &Scene<R>) -> Setpoint<R> {
        Setpoint::origin()
    }

    fn judge<R: Scalar>(&self, _: usize, _: &Situation<R>, _: &Scene<R>) -> Outcome<R> {
        let nothing = R::nothing();
        Outcome { reward: R::zero(), error_m: R::zero(), arrived: nothing, ends: nothing }
    }
}
