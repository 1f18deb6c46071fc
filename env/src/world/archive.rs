//! The state from which the flights of a tile continue.

use std::slice::from_mut;

use super::World;
use crate::archive::{Archive, Ledger};
use crate::lanes::LANES;
use crate::scalar::Word;
use crate::sim_scalar::{BatchScalar, SimScalar};

impl<R: SimScalar> World<R> {
    /// `key` is that of a lane's episode.
    pub(crate) fn archive(&mut self, tile: usize, key: impl Fn(usize) -> u64, archive: &mut Archive<'_>)
    where
        R: BatchScalar,
    {
        self.show_numbers(tile, archive);
        archive.count(&mut self.clocks[tile]);
        let age = &mut self.ages[tile];
        if archive.reads() {
            for lane in 0..LANES {
                age.keys.set_lane(lane, key(lane));
                // counted beside the number, which is exact for the two days that a clock in `f32` lasts
                age.tick.set_lane(lane, age.ticks.lane(lane) as u32);
            }
        }
    }

    /// Shows the numbers that the flights of a tile go on from. Besides them there are the words of the noise,
    /// and the clock.
    pub(crate) fn show_numbers(&mut self, tile: usize, ledger: &mut dyn Ledger<R>) {
        let x = &mut self.states[tile];
        ledger.numbers("pos_m", &mut x.pos_m);
        ledger.numbers("vel_mps", &mut x.vel_mps);
        ledger.numbers("att_rad", &mut x.att_rad);
        ledger.numbers("rate_radps", &mut x.rate_radps);
        ledger.numbers("lag", &mut x.aux);
        let t = &mut self.tiles[tile];
        ledger.numbers("acc_mps2", &mut t.acc_mps2);
        ledger.numbers("until_frame", from_mut(&mut t.until_frame));
        ledger.numbers("fix_pos_m", &mut t.fix.pos_m);
        ledger.numbers("fix_yaw_rad", from_mut(&mut t.fix.yaw_rad));
        ledger.numbers("fix_t_s", from_mut(&mut t.fix.t_s));
        ledger.numbers("fix_valid", from_mut(&mut t.fix.valid));
        ledger.numbers("ticks", from_mut(&mut self.ages[tile].ticks));
        if let Some(motors) = &mut self.motors {
            motors.show_numbers(tile, ledger);
        }
        for (stage, name) in self.stages.iter_mut().zip(&self.names) {
            stage.numbers().visit_tile(tile, &mut |numbers| ledger.numbers(name, numbers));
        }
    }
}
