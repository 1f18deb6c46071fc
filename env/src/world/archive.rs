//! What the flights of a tile go on from.

use super::World;
use crate::archive::Archive;
use crate::lanes::LANES;
use crate::scalar::Word;
use crate::sim_scalar::{BatchScalar, SimScalar};

impl<R: SimScalar> World<R> {
    /// `key` is that of a lane's episode.
    pub(crate) fn archive(&mut self, tile: usize, key: impl Fn(usize) -> u64, archive: &mut Archive<'_>)
    where
        R: BatchScalar,
    {
        let x = &mut self.states[tile];
        for numbers in [&mut x.pos_m, &mut x.vel_mps, &mut x.att_rad, &mut x.rate_radps] {
            archive.numbers(numbers);
        }
        archive.numbers(&mut x.aux);
        let t = &mut self.tiles[tile];
        archive.numbers(&mut t.acc_mps2);
        archive.number(&mut t.until_frame);
        archive.numbers(&mut t.fix.pos_m);
        for number in [&mut t.fix.yaw_rad, &mut t.fix.t_s, &mut t.fix.valid] {
            archive.number(number);
        }
        archive.count(&mut self.clocks[tile]);
        let age = &mut self.ages[tile];
        archive.number(&mut age.ticks);
        if archive.reads() {
            for lane in 0..LANES {
                age.keys.set_lane(lane, key(lane));
                // counted beside the number, which is exact for the two days that a clock in `f32` lasts
                age.tick.set_lane(lane, age.ticks.lane(lane) as u32);
            }
        }
        if let Some(motors) = &mut self.motors {
            motors.archive(tile, archive);
        }
        for stage in &mut self.stages {
            stage.visit_tile(tile, &mut |number| archive.number(number));
        }
    }
}
