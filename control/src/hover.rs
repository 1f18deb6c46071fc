//! Level, with the thrust that carries the weight; and the thesis's steps of chapter 5 from there.

use super::batch::check;
use super::{Controller, Entry, defaults, options};
use crazyflie_env::action::{ACTION, Interface};
use crazyflie_env::error::Result;
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::plant::Command;

options! {
    roll_deg: f64 = 0.0, "commanded roll";
    pitch_deg: f64 = 0.0, "commanded pitch";
    yaw_rate_degps: f64 = 0.0, "commanded yaw rate, with the model's sign";
    from_s: f64 = 0.0, "time from which on these are commanded";
}

pub(super) const ENTRY: Entry = Entry {
    name: "hover",
    also: None,
    about: "Level, with the thrust that carries the weight: the baseline without control; or a fixed command from a time on",
    source: "the model's hover PWM; where a height is commanded, the set-point's; thesis 5.1: steps of 7.5 degrees and 36 deg/s after 10 s of hover",
    any_level: false,
    file: None,
    member: None,
    options: OPTIONS,
    defaults: defaults::<Options>,
    build: |given, site| {
        let options = given.options::<Options>()?;
        let first = (options.from_s / site.tick_s).ceil().max(0.0) as u64;
        Ok(Box::new(Hover { interface: site.interface, options, first, ticks: vec![0; site.envs] }))
    },
};

struct Hover {
    interface: Interface,
    options: Options,
    /// Tick from which on the options are commanded.
    first: u64,
    /// Ticks of each environment since its reset.
    ticks: Vec<u64>,
}

impl Controller for Hover {
    fn reset(&mut self, of: &dyn Fn(usize) -> bool) {
        self.ticks.iter_mut().enumerate().filter(|(env, _)| of(*env)).for_each(|(_, tick)| *tick = 0);
    }

    fn act(&mut self, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        check(self.ticks.len(), observations, actions)?;
        let rows = actions.chunks_exact_mut(ACTION).zip(observations.chunks_exact(OBSERVATION));
        for ((action, seen), tick) in rows.zip(&mut self.ticks) {
            let lift =
                if self.interface.input.is_pwm() { self.interface.hover_lift } else { f64::from(seen[18]) };
            let mut command = Command::level(lift);
            if *tick >= self.first {
                command.roll_rad = self.options.roll_deg.to_radians();
                command.pitch_rad = self.options.pitch_deg.to_radians();
                command.yaw_rate_radps = self.options.yaw_rate_degps.to_radians();
            }
            *tick += 1;
            action.copy_from_slice(&self.interface.action(&command).map(|a| a as f32));
        }
        Ok(())
    }
}
