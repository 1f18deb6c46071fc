//! An effect with its parameters and states for all tiles of a world.

use std::marker::PhantomData;

use super::{Call, Effect, Entry, Frame, HookContext, Param, Reading};
use crate::plant::{Accelerations, Command, State};
use crate::scalar::Scalar;
use crate::sim_scalar::SimScalar;
use crate::world::Tick;

/// Parameters to build a stage.
#[derive(Debug, Clone, Copy)]
pub struct Build {
    pub tiles: usize,
    /// Parameters differ between drones (domain randomisation); otherwise they are stored once.
    pub per_drone: bool,
    /// Length of a control tick.
    pub tick_s: f64,
}

/// The tiles for which a hook is called: those from `first` on, as many as the slices are long.
pub struct Tiles<'a, R: Scalar> {
    pub first: usize,
    pub cx: &'a [HookContext<'a, R>],
    pub x: &'a [State<R>],
    /// The commands in force; empty for hooks that have no use for them.
    pub u: &'a [Command<R>],
}

impl<R: Scalar> Tiles<'_, R> {
    #[inline(always)]
    fn call<'b, const P: usize>(&'b self, i: usize, params: &'b [R; P]) -> Call<'b, R, P> {
        Call { params, x: &self.x[i], context: &self.cx[i] }
    }
}

/// A built effect: one virtual call per group of tiles, none per drone.
pub trait Stage<R: Scalar>: Send {
    /// All parameters and states.
    fn numbers(&mut self) -> Numbers<'_, R>;
    /// See [`Effect::RING`].
    fn ring(&self) -> usize;
    /// Begin an episode in the lanes of `mask`.
    fn start(&mut self, tile: usize, mask: R::Mask, cx: &HookContext<R>, x: &State<R>, u: &Command<R>);
    fn command(&mut self, of: &Tiles<R>, u: &mut [Command<R>]);
    /// Replaces the rates of states by those that torques depend on.
    fn rates(&mut self, of: &Tiles<R>, middle: &mut [State<R>]);
    fn push(&mut self, of: &Tiles<R>, out: &mut [Accelerations<R>]);
    fn frame(&mut self, of: &Tiles<R>, frames: &mut [Frame<R>]);
    fn sense(&mut self, of: &Tiles<R>, ticks: &mut [Tick<R>]);
    /// Like `sense`, without moving any state on: for the first reading of an episode while the tile's other lanes
    /// are under way.
    fn peek(&self, tile: usize, cx: &HookContext<R>, x: &State<R>, y: &mut Reading<R>);
}

/// All numbers of a stage, tile after tile. Operations on them here are compiled once for each number type, not once
/// more for each effect.
pub struct Numbers<'a, R> {
    params: &'a mut [R],
    params_per_tile: usize,
    /// Each tile has parameters of its own; otherwise all share the first.
    per_drone: bool,
    states: &'a mut [R],
    states_per_tile: usize,
    /// See [`Effect::MOTION_STATES`].
    lags: usize,
}

impl<R: SimScalar> Numbers<'_, R> {
    /// Set a lane's parameters.
    pub fn set(self, tile: usize, lane: usize, params: &[f64]) {
        let first = if self.per_drone { tile * self.params_per_tile } else { 0 };
        for (slot, value) in self.params[first..][..self.params_per_tile].iter_mut().zip(params) {
            if self.per_drone { slot.set_lane(lane, *value) } else { *slot = R::from_f64(*value) }
        }
    }

    /// Set the parameters that all lanes share, with whatever the number type carries.
    pub fn set_params(self, params: &[R]) {
        self.params[..self.params_per_tile].copy_from_slice(params);
    }

    /// Show all that the effect remembers, or of that only the lags.
    pub fn visit(self, only_lags: bool, see: &mut dyn FnMut(&mut R)) {
        let not_seen = if only_lags { self.states_per_tile - self.lags } else { 0 };
        // without states there are none to chunk
        for tile in self.states.chunks_exact_mut(self.states_per_tile.max(1)) {
            tile[not_seen..].iter_mut().for_each(&mut *see);
        }
    }

    /// Show all that is of one tile: parameters that differ from drone to drone, and what the effect
    /// remembers.
    pub fn visit_tile(self, tile: usize, see: &mut dyn FnMut(&mut [R])) {
        if self.per_drone {
            see(&mut self.params[tile * self.params_per_tile..][..self.params_per_tile]);
        }
        see(&mut self.states[tile * self.states_per_tile..][..self.states_per_tile]);
    }
}

pub struct StageOf<E, R, const P: usize, const S: usize> {
    params: Vec<[R; P]>,
    states: Vec<[R; S]>,
    /// 1 where each tile has parameters of its own, 0 where all share the first.
    stride: usize,
    effect: PhantomData<fn() -> E>,
}

impl<E: Effect<P, S>, R: SimScalar, const P: usize, const S: usize> StageOf<E, R, P, S> {
    fn boxed(build: Build) -> Box<dyn Stage<R>> {
        if let Some(wider) = E::wider(build) {
            return wider;
        }
        Box::new(Self {
            params: off_values(&E::PARAMS, if build.per_drone { build.tiles } else { 1 }),
            states: zeros(build.tiles),
            stride: usize::from(build.per_drone),
            effect: PhantomData,
        })
    }
}

impl<E: Effect<P, S>, R: SimScalar, const P: usize, const S: usize> StageOf<E, R, P, S> {
    /// Calls `hook` with each tile's parameters and states.
    #[inline(always)]
    fn each(&mut self, of: &Tiles<R>, mut hook: impl FnMut(usize, &[R; P], &mut [R; S])) {
        let (count, first) = (of.cx.len(), of.first);
        let states = &mut self.states[first..first + count];
        let params = if self.stride == 1 { &self.params[first..first + count] } else { &self.params[..1] };
        R::run(
            #[inline(always)]
            || {
                R::enter(E::NAME);
                for i in 0..count {
                    hook(i, &params[i * self.stride], &mut states[i]);
                }
            },
        );
    }
}

impl<E: Effect<P, S>, R: SimScalar, const P: usize, const S: usize> Stage<R> for StageOf<E, R, P, S> {
    fn numbers(&mut self) -> Numbers<'_, R> {
        Numbers {
            params: self.params.as_flattened_mut(),
            params_per_tile: P,
            per_drone: self.stride == 1,
            states: self.states.as_flattened_mut(),
            states_per_tile: S,
            lags: E::MOTION_STATES,
        }
    }

    fn ring(&self) -> usize {
        E::RING
    }

    fn start(&mut self, tile: usize, mask: R::Mask, cx: &HookContext<R>, x: &State<R>, u: &Command<R>) {
        let (params, states) = (&self.params[tile * self.stride], &mut self.states[tile]);
        R::run(
            #[inline(always)]
            || {
                let fresh = E::start(Call { params, x, context: cx }, u);
                for i in 0..S {
                    states[i] = R::select(mask, fresh[i], states[i]);
                }
            },
        );
    }

    fn command(&mut self, of: &Tiles<R>, u: &mut [Command<R>]) {
        if const { E::HOOKS.command } {
            self.each(
                of,
                #[inline(always)]
                |i, p, s| E::command(of.call(i, p), s, &mut u[i]),
            );
        }
    }

    fn rates(&mut self, of: &Tiles<R>, middle: &mut [State<R>]) {
        if const { E::HOOKS.rates } {
            self.each(
                of,
                #[inline(always)]
                |i, p, _| middle[i].rate_radps = E::body_rates(p, &middle[i]),
            );
        }
    }

    fn push(&mut self, of: &Tiles<R>, out: &mut [Accelerations<R>]) {
        if const { E::HOOKS.push } {
            self.each(
                of,
                #[inline(always)]
                |i, p, s| E::push(of.call(i, p), s, &of.u[i], &mut out[i]),
            );
        }
    }

    fn frame(&mut self, of: &Tiles<R>, frames: &mut [Frame<R>]) {
        if const { E::HOOKS.frame } {
            self.each(
                of,
                #[inline(always)]
                |i, p, s| {
                    if R::any(frames[i].captured) {
                        E::frame(of.call(i, p), s, &mut frames[i]);
                    }
                },
            );
        }
    }

    fn sense(&mut self, of: &Tiles<R>, ticks: &mut [Tick<R>]) {
        if const { E::HOOKS.sense } {
            self.each(
                of,
                #[inline(always)]
                |i, p, s| E::sense(of.call(i, p), s, &mut ticks[i].reading),
            );
        }
    }

    fn peek(&self, tile: usize, cx: &HookContext<R>, x: &State<R>, y: &mut Reading<R>) {
        if const { E::HOOKS.sense } {
            let (params, mut state) = (&self.params[tile * self.stride], self.states[tile]);
            R::run(
                #[inline(always)]
                || E::sense(Call { params, x, context: cx }, &mut state, y),
            );
        }
    }
}

/// The parameters of so many tiles of an effect that is off. Not inlined: effects with as many share the code.
#[inline(never)]
fn off_values<R: Scalar, const P: usize>(params: &[Param; P], tiles: usize) -> Vec<[R; P]> {
    vec![std::array::from_fn(|i| R::from_f64(params[i].off)); tiles]
}

#[inline(never)]
fn zeros<R: Scalar, const S: usize>(tiles: usize) -> Vec<[R; S]> {
    vec![[R::zero(); S]; tiles]
}

/// An effect built. Takes a reference so that `P` and `S` are inferred from the one impl.
pub(super) fn boxed<E: Effect<P, S>, R: SimScalar, const P: usize, const S: usize>(
    _effect: &E,
    build: Build,
) -> Box<dyn Stage<R>> {
    StageOf::<E, R, P, S>::boxed(build)
}

/// The registry entry of an effect. Takes a reference so that `P` and `S` are inferred from the one impl.
pub(super) const fn entry<E: Effect<P, S>, const P: usize, const S: usize>(_effect: &E) -> Entry {
    Entry {
        name: E::NAME,
        about: E::ABOUT,
        source: E::SOURCE,
        params: const { &E::PARAMS },
        hooks: E::HOOKS,
        physics_hz: E::PHYSICS_HZ,
        observability: E::OBSERVABILITY,
        geometry: E::MODEL_FORM,
        scope: E::SCOPE,
        model_number: E::MODEL_NUMBER,
        feels_air: E::FEELS_AIR,
        delays: E::DELAYS,
        is_battery: E::IS_BATTERY,
        ubiquity: E::UBIQUITY,
        flight_spread: E::FLIGHT_SPREAD,
        lags: E::MOTION_STATES,
        lag_sd: E::LAG_SD,
        starts: E::STARTS.as_flattened(),
        motion_memory_s: E::MOTION_MEMORY_S,
        lanes: StageOf::<E, _, P, S>::boxed,
        #[cfg(all(target_arch = "x86_64", not(test)))]
        avx2: StageOf::<E, _, P, S>::boxed,
        #[cfg(all(target_arch = "x86_64", not(test)))]
        avx512: StageOf::<E, _, P, S>::boxed,
        double: StageOf::<E, _, P, S>::boxed,
        #[cfg(feature = "recording")]
        symbol: StageOf::<E, _, P, S>::boxed,
        dual: StageOf::<E, _, P, S>::boxed,
        mean: StageOf::<E, _, P, S>::boxed,
    }
}
