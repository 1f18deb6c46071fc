//! The phases of a control tick of a group of tiles, in the order in which a step calls them. Each costs one virtual
//! call per effect that has its hook, for the whole group, and nothing where there is none.

use super::camera_clock::CameraClock;
use super::force::Outside;
use super::parts::{advance, felt, land, thrust_commands};
use super::wind::Wind;
use super::{Age, GROUP, Group, Order, Tick, Tile, Times};
use crate::effects::{Frame, HookContext, PoseFix, Reading, Stage, Tiles};
use crate::motors::MotorVehicle;
use crate::plant::{Accelerations, Command, Plant, State};
use crate::scalar::tabulate;
use crate::sim_scalar::SimScalar;

/// Contexts of the hooks, one for each tile of a group.
pub(super) type Contexts<'a, R> = [HookContext<'a, R>; GROUP];

/// A tick of some tiles side by side, with the parts of their world. The contexts of its hooks are separate: stages
/// see them, and the rest stays in registers.
pub(super) struct GroupStep<'a, R: SimScalar> {
    pub(super) first: usize,
    pub(super) n: usize,
    pub(super) h_s: f64,
    pub(super) tick_s: f64,
    pub(super) times: &'a Times<R>,
    pub(super) gravity_mps2: R,
    pub(super) floor: bool,
    pub(super) plant: &'a Plant<R>,
    pub(super) motors: &'a mut Option<MotorVehicle<R>>,
    pub(super) states: &'a mut [State<R>],
    pub(super) tiles: &'a mut [Tile<R>],
    pub(super) ages: &'a [Age<R>],
    pub(super) stages: &'a mut [Box<dyn Stage<R>>],
    pub(super) order: &'a Order,
    pub(super) group: &'a mut Group<R>,
    pub(super) wind: &'a mut Option<Wind<R>>,
    pub(super) feels_air: &'a [bool],
    pub(super) filming: CameraClock,
    pub(super) outside: Outside<'a, R>,
}

impl<R: SimScalar> GroupStep<'_, R> {
    /// Before the first physics step: the command as it is given, what pushes from outside, and no frame.
    #[inline(always)]
    pub(super) fn begin(&mut self, commands: &[Command<R>]) {
        for i in 0..self.n {
            self.group.captured[i] = R::nothing();
            self.group.push[i] = self.outside.push(i);
            self.group.u[i] = commands[i];
        }
    }

    /// Before each physics step: effects on the command.
    #[inline(always)]
    pub(super) fn command(&mut self, cx: &Contexts<'_, R>, commands: &[Command<R>]) {
        if self.order.command.is_empty() {
            return;
        }
        let n = self.n;
        self.group.u[..n].copy_from_slice(&commands[..n]);
        let of = Tiles { first: self.first, cx: &cx[..n], x: self.states, u: &[] };
        for &stage in &self.order.command {
            self.stages[stage].command(&of, &mut self.group.u[..n]);
        }
    }

    /// Computes the pushes in the middle of the next physics step. External pushes are added last, because effects on
    /// the thrust scale all that is there as thrust.
    #[inline(always)]
    pub(super) fn push(&mut self, cx: &Contexts<'_, R>) {
        if self.order.push.is_empty() && self.wind.is_none() {
            return;
        }
        let n = self.n;
        for i in 0..n {
            self.group.push[i] = Accelerations::none();
            self.group.middle[i] = self.states[i].ahead(&self.tiles[i].acc_mps2, 0.5 * self.h_s);
        }
        for &stage in &self.order.rates {
            let of = Tiles { first: self.first, cx: &cx[..n], x: &[], u: &[] };
            self.stages[stage].rates(&of, &mut self.group.middle[..n]);
        }
        if let Some(wind) = &mut *self.wind {
            wind.meet(&self.group.middle[..n]);
        }
        self.push_by_effects(cx);
        if self.outside.is_there() {
            for i in 0..n {
                self.group.push[i].add(&self.outside.push(i));
            }
        }
        if let Some(wind) = &mut *self.wind {
            self.group.push[..n].iter_mut().enumerate().for_each(|(i, push)| wind.push(i, push));
        }
    }

    #[inline(always)]
    fn push_by_effects(&mut self, cx: &Contexts<'_, R>) {
        let n = self.n;
        let thrusts = self.motors.as_ref().map(|motors| thrust_commands(motors, self.first, self.states));
        let u = &thrusts.as_ref().unwrap_or(&self.group.u)[..n];
        for &stage in &self.order.push {
            let x = match &*self.wind {
                Some(wind) if self.feels_air[stage] => &wind.in_air[..n],
                _ => &self.group.middle[..n],
            };
            let of = Tiles { first: self.first, cx: &cx[..n], x, u };
            self.stages[stage].push(&of, &mut self.group.push[..n]);
        }
    }

    /// Physics step number `count` of the tick: motion, the floor, and whether a frame is taken on the way.
    #[inline(always)]
    pub(super) fn advance(&mut self, cx: &mut Contexts<'_, R>, count: u32, ticks: &mut [Tick<R>]) {
        R::enter("model");
        let films = self.films();
        for i in 0..self.n {
            let (x, t, tick) = (&mut self.states[i], &mut self.tiles[i], &mut ticks[i]);
            let (u, push) = (&self.group.u[i], &self.group.push[i]);
            let (mut next, heading, up_mps2) =
                advance(self.plant, self.motors.as_mut(), self.first + i, x, u, push);
            if self.floor {
                land(&mut next, x.pos_m[2], &mut tick.contact);
            }
            if films {
                let (seen, captured) = (&mut self.group.seen[i], &mut self.group.captured[i]);
                self.filming.look(count, t.until_frame, [x, &next], seen, captured);
            }
            let per_h = self.times.per_h;
            t.acc_mps2 = tabulate(
                #[inline(always)]
                |k| (next.vel_mps[k] - x.vel_mps[k]) * per_h,
            );
            let up_mps2 = felt(up_mps2, t.acc_mps2[2] + self.gravity_mps2, tick.contact.standing);
            tick.reading.acc_mps2 = heading.specific(&self.group.push[i], up_mps2);
            *x = next;
            cx[i].first = false;
            cx[i].since_tick_s += self.h_s;
            cx[i].t_s += self.times.h_s;
        }
    }

    /// Something films, so that frames have their own time.
    #[inline(always)]
    fn films(&self) -> bool {
        !self.order.frame.is_empty()
    }

    /// After the last physics step: effects on the camera frame of the tick.
    #[inline(always)]
    pub(super) fn film(&mut self, cx: &mut Contexts<'_, R>) {
        if !self.films() {
            return;
        }
        let (n, schedule) = (self.n, &self.filming.schedule);
        for i in 0..n {
            let t_s = self.ages[i].began_s(self.times)
                + self.tiles[i].until_frame * R::from_f64(schedule.seconds(1));
            self.group.frames[i] = Frame::from_state(&self.group.seen[i], self.group.captured[i], t_s);
            cx[i].t_s = self.ages[i].ticks * self.times.tick_s;
            cx[i].h_s = schedule.seconds(schedule.camera);
        }
        let of = Tiles { first: self.first, cx: &cx[..n], x: &self.group.seen[..n], u: &[] };
        for &stage in &self.order.frame {
            self.stages[stage].frame(&of, &mut self.group.frames[..n]);
        }
    }

    /// At the end of the tick: what the sensors show before any effect.
    #[inline(always)]
    pub(super) fn read(&mut self, cx: &mut Contexts<'_, R>, ticks: &mut [Tick<R>]) {
        let films = self.films();
        for i in 0..self.n {
            cx[i].t_s = self.ages[i].ticks * self.times.tick_s;
            cx[i].h_s = self.tick_s;
            let marker = if films {
                self.filming.deliver(self.group.captured[i], &self.group.frames[i], &mut self.tiles[i])
            } else {
                PoseFix::ideal(&self.states[i], cx[i].t_s)
            };
            ticks[i].reading = Reading::from_state(&self.states[i], ticks[i].reading.acc_mps2, marker);
            if self.motors.is_some() {
                ticks[i].reading.gyro_radps = MotorVehicle::gyro_radps(&self.states[i]);
            }
        }
    }

    /// At the end of the tick: effects on the reading.
    #[inline(always)]
    pub(super) fn sense(&mut self, cx: &Contexts<'_, R>, ticks: &mut [Tick<R>]) {
        let n = self.n;
        let of = Tiles { first: self.first, cx: &cx[..n], x: self.states, u: &[] };
        for &stage in &self.order.sense {
            self.stages[stage].sense(&of, ticks);
        }
        if self.films() {
            for i in 0..n {
                self.tiles[i].fix = ticks[i].reading.marker;
            }
        }
    }
}
