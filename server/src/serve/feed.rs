//! The feed that a session shows to its watchers: the newest rows of its first environments, or of all drones
//! of a shared world, written in place. A session never waits for a watcher and never wakes one.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use crazyflie_env::action::Interface;
use crazyflie_env::config::{Autoreset, Options};
use crazyflie_env::observation::{LAST_ACTION, OBSERVATION};
use crazyflie_env::vector::{STATE, VectorEnv};
use serde_json::Value;

use super::{CountGuard, lock};
use crate::flight::metric;
use crate::frames::{self, ALL_COLUMNS, COLUMNS};
use crate::worlds::WorldFlight;

/// Number of environments of a batch that can be watched: the first ones.
pub(crate) const WATCHABLE: usize = 16;

/// The newest rows of a session, for its watchers.
pub(crate) struct Feed {
    /// Names of the columns, markers and camera.
    pub header: Value,
    /// Rows for each environment.
    pub drones: usize,
    watchers: AtomicUsize,
    version: AtomicU64,
    rows: Mutex<Vec<f32>>,
    /// Numbers for each environment.
    width: usize,
}

impl Feed {
    pub(crate) fn new(options: &Options, tick_s: f64) -> Self {
        let header = frames::header(&options.effects, &COLUMNS, 1, tick_s);
        Feed::with_header(header, WATCHABLE, 1, COLUMNS.len())
    }

    /// A feed of a shared world: all its drones are watched together.
    pub(crate) fn for_world(options: &Options, tick_s: f64, drones: usize, world: &str) -> Self {
        let mut feed = Feed::for_multi_drone(options, tick_s, drones);
        feed.header["world"] = world.into();
        feed
    }

    /// A feed of environments of several drones: those of the first one are watched, together.
    pub(crate) fn for_multi_drone(options: &Options, tick_s: f64, drones: usize) -> Self {
        let header = frames::header(&options.effects, &ALL_COLUMNS, drones, tick_s);
        Feed::with_header(header, 1, drones, drones * ALL_COLUMNS.len())
    }

    fn with_header(header: Value, envs: usize, drones: usize, width: usize) -> Self {
        let (watchers, version, rows) =
            (AtomicUsize::new(0), AtomicU64::new(0), Mutex::new(vec![0.0; envs * width]));
        Feed { header, drones, watchers, version, rows, width }
    }

    /// A watcher, for as long as it lives.
    pub(crate) fn watch(&self) -> CountGuard<'_> {
        CountGuard::new(&self.watchers)
    }

    pub(crate) fn watchers(&self) -> usize {
        self.watchers.load(Ordering::Relaxed)
    }

    /// The newest rows of an environment, if they are newer than `seen`.
    pub(crate) fn newer(&self, env: usize, seen: &mut u64) -> Option<Vec<f32>> {
        let version = self.version.load(Ordering::Acquire);
        if version == *seen {
            return None;
        }
        *seen = version;
        lock(&self.rows).chunks(self.width).nth(env).map(<[f32]>::to_vec)
    }

    /// Shows all drones of a shared world.
    pub(crate) fn show_shared(&self, flight: &WorldFlight) {
        if self.watchers() == 0 {
            return;
        }
        let batch = &flight.batch;
        self.show_all_drones(&MultiDroneRows {
            t_s: flight.ticks as f64 * flight.tick_s(),
            width: batch.env.width(),
            observations: &batch.observations,
            states: &batch.states,
            actions: &batch.actions,
            rewards: Some(&batch.rewards),
            flying: &batch.flying,
            interfaces: batch.env.interfaces(),
            least_separation_m: flight.least_separation_m(),
        });
    }

    pub(crate) fn show_all_drones(&self, now: &MultiDroneRows<'_>) {
        let separations_m = frames::separations_m(now.states, now.flying);
        let (states, actions) = (now.states.as_chunks::<STATE>().0, now.actions.as_chunks().0);
        let mut rows = lock(&self.rows);
        let slots = rows.chunks_mut(ALL_COLUMNS.len()).zip(now.observations.chunks(now.width));
        for (drone, ((slot, observation), separation_m)) in slots.zip(separations_m).enumerate() {
            let Some(observation) = observation.first_chunk() else { return };
            let (interface, reward) =
                (&now.interfaces[drone], now.rewards.map_or(0.0, |rewards| rewards[drone]));
            let (own, shared) = slot.split_at_mut(COLUMNS.len());
            own.copy_from_slice(&frames::row(
                now.t_s,
                observation,
                &states[drone],
                &actions[drone],
                interface,
                reward,
            ));
            let flying = if now.flying[drone] { 1.0 } else { 0.0 };
            shared.copy_from_slice(&[flying, separation_m, now.least_separation_m]);
        }
        drop(rows);
        self.version.fetch_add(1, Ordering::Release);
    }
}

/// Results of a step or a reset: rows for each drone of all environments. A reset has neither rewards nor
/// metrics.
pub(crate) struct FeedRows<'a> {
    pub observations: &'a [f32],
    pub rewards: Option<&'a [f32]>,
    /// Flags of the drones that fly on; empty for tasks of one drone.
    pub flying: &'a [bool],
    /// Metrics of the first environment.
    pub metrics: &'a [f32],
}

/// The drones of one environment at a moment, rows for each.
pub(crate) struct MultiDroneRows<'a> {
    pub t_s: f64,
    pub width: usize,
    pub observations: &'a [f32],
    pub states: &'a [f32],
    pub actions: &'a [f32],
    pub rewards: Option<&'a [f32]>,
    pub flying: &'a [bool],
    pub interfaces: &'a [Interface],
    pub least_separation_m: f32,
}

/// Steps of the watchable environments within their episodes.
pub(crate) struct EpisodeClocks {
    steps: [u32; WATCHABLE],
    over: [bool; WATCHABLE],
    autoreset: Autoreset,
    tick_s: f64,
}

impl EpisodeClocks {
    pub(crate) fn new(autoreset: Autoreset, tick_s: f64) -> Self {
        EpisodeClocks { steps: [0; WATCHABLE], over: [false; WATCHABLE], autoreset, tick_s }
    }

    pub(crate) fn begin(&mut self, mask: Option<&[bool]>) {
        for (env, steps) in self.steps.iter_mut().enumerate() {
            if mask.is_none_or(|mask| mask.get(env).copied().unwrap_or(false)) {
                (*steps, self.over[env]) = (0, false);
            }
        }
    }

    /// A step after which these episodes are over.
    pub(crate) fn step(&mut self, over: &[bool]) {
        for (env, over) in over.iter().enumerate().take(WATCHABLE) {
            let begins = match self.autoreset {
                Autoreset::NextStep => self.over[env],
                Autoreset::SameStep => *over,
                Autoreset::Disabled => false,
            };
            (self.steps[env], self.over[env]) = (if begins { 0 } else { self.steps[env] + 1 }, *over);
        }
    }

    /// The first environment, whose drones are watched together.
    fn show_all_drones(&self, feed: &Feed, env: &VectorEnv, shown: &FeedRows<'_>) {
        let (drones, width) = (env.num_drones(), env.measured_width());
        let mut states = vec![0.0; drones * STATE];
        // the buffer is whole rows of drones that exist
        if env.first_states(&mut states).is_err() {
            return;
        }
        let observations = &env.measured(shown.observations)[..drones * width];
        let actions: Vec<f32> =
            observations.chunks(width).flat_map(|row| &row[LAST_ACTION.range()]).copied().collect();
        let begun = vec![true; drones];
        let flying = shown.flying.get(..drones).unwrap_or(&begun);
        let measured = metric(shown.metrics, "min_separation_m");
        let now_m = || frames::separations_m(&states, flying).fold(f32::INFINITY, f32::min);
        feed.show_all_drones(&MultiDroneRows {
            t_s: f64::from(self.steps[0]) * self.tick_s,
            width,
            observations,
            states: &states,
            actions: &actions,
            rewards: shown.rewards,
            flying,
            interfaces: env.interfaces(),
            least_separation_m: measured.unwrap_or_else(now_m),
        });
    }

    /// Shows the newest observations and rewards, with the true states.
    pub(crate) fn show(&self, feed: &Feed, env: &VectorEnv, shown: &FeedRows<'_>) {
        if env.num_metrics() > 0 {
            return self.show_all_drones(feed, env, shown);
        }
        let FeedRows { observations, rewards, .. } = *shown;
        let n = env.num_envs().min(WATCHABLE);
        let mut states = [0.0; WATCHABLE * STATE];
        // the buffer is whole rows of environments that exist
        if env.first_states(&mut states[..n * STATE]).is_err() {
            return;
        }
        let interface = env.interfaces()[0];
        let mut rows = lock(&feed.rows);
        let observations = env.measured(observations);
        let drones_now = observations.as_chunks::<OBSERVATION>().0.iter().zip(states.as_chunks::<STATE>().0);
        for (env, (row, (observation, state))) in
            rows.chunks_mut(COLUMNS.len()).zip(drones_now).take(n).enumerate()
        {
            let reward = rewards.map_or(0.0, |rewards| rewards[env]);
            let action = std::array::from_fn(|i| observation[LAST_ACTION.first + i]);
            let t_s = f64::from(self.steps[env]) * self.tick_s;
            row.copy_from_slice(&frames::row(t_s, observation, state, &action, &interface, reward));
        }
        drop(rows);
        feed.version.fetch_add(1, Ordering::Release);
    }
}
