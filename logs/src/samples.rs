//! The messages of a topic as samples in order of time, on the recorder's clock.

use super::Note;
use super::align::{ClockOffset, clock_offset};
use super::signal::usual_step;
use super::topics::Topic;

/// A stamp further from its record time than this, its clock's offset removed, is not believed.
const LONGEST_STRAY_S: f64 = 1.0;
/// From this many usual steps on, messages were lost; radio and scheduling shift single ones by less.
const GAP_STEPS: f64 = 1.9;

/// Samples with strictly increasing times, never empty.
#[derive(Debug)]
pub(super) struct Samples {
    /// When it was measured or sent: the stamp, where there is one, else the time of record.
    pub(super) t_s: Vec<f64>,
    /// When it was recorded.
    pub(super) arrived_s: Vec<f64>,
    pub(super) values: Vec<Vec<f64>>,
    /// The stamps' clock, `None` if the messages have no stamps.
    pub(super) clock: Option<ClockOffset>,
}

impl Samples {
    /// Brings a topic to the recorder's clock, in seconds from `origin_ns`, and notes what was odd on the
    /// way.
    pub(super) fn from_topic(topic: &Topic, origin_ns: u64, notes: &mut Vec<Note>) -> Self {
        let seconds = |ns: u64| (i128::from(ns) - i128::from(origin_ns)) as f64 * 1e-9;
        let arrived_s: Vec<f64> = topic.recorded_ns.iter().map(|ns| seconds(*ns)).collect();
        let stamps = topic.stamp_ns.iter().zip(&arrived_s);
        let stamped = stamps.filter_map(|(stamp, arrived)| Some((seconds((*stamp)?), *arrived)));
        let stamped: Vec<(f64, f64)> = stamped.collect();
        let mut samples =
            Self { t_s: arrived_s.clone(), arrived_s, values: topic.values.clone(), clock: None };
        if 2 * stamped.len() > topic.values.len() {
            let (stamps, arrivals): (Vec<f64>, Vec<f64>) = stamped.into_iter().unzip();
            let clock = clock_offset(&stamps, &arrivals);
            samples.stamp(topic, clock, seconds, notes);
        } else {
            notes.push(Note::NoStamps { topic: topic.name.clone() });
        }
        samples.sort(topic, notes);
        samples.note_gaps(topic, notes);
        samples
    }

    /// Replaces times of record by stamps, except where a stamp strays.
    fn stamp(
        &mut self,
        topic: &Topic,
        clock: ClockOffset,
        seconds: impl Fn(u64) -> f64,
        notes: &mut Vec<Note>,
    ) {
        let mut stray = 0;
        for ((t, stamp), arrived) in self.t_s.iter_mut().zip(&topic.stamp_ns).zip(&self.arrived_s) {
            let on_clock = stamp.map(|ns| seconds(ns) + clock.offset_s);
            match on_clock.filter(|t| (t - arrived).abs() <= LONGEST_STRAY_S) {
                Some(stamped) => *t = stamped,
                None => {
                    *t = arrived - clock.transport_s;
                    stray += 1;
                }
            }
        }
        let ClockOffset { offset_s, same, transport_s, spread_s, drift_ppm } = clock;
        let topic = topic.name.clone();
        if stray > 0 {
            notes.push(Note::StrayStamps { topic: topic.clone(), count: stray });
        }
        notes.push(Note::TopicClock { topic, same, offset_s, transport_s, spread_s, drift_ppm });
        self.clock = Some(clock);
    }

    /// Orders the samples by time; of equal times the first counts.
    fn sort(&mut self, topic: &Topic, notes: &mut Vec<Note>) {
        let count = self.t_s.windows(2).filter(|pair| pair[1] <= pair[0]).count();
        if count == 0 {
            return;
        }
        notes.push(Note::StampsOutOfOrder { name: topic.name.clone(), count });
        let mut order: Vec<usize> = (0..self.t_s.len()).collect();
        order.sort_by(|a, b| self.t_s[*a].total_cmp(&self.t_s[*b]));
        order.dedup_by(|later, earlier| self.t_s[*later] == self.t_s[*earlier]);
        self.t_s = order.iter().map(|at| self.t_s[*at]).collect();
        self.arrived_s = order.iter().map(|at| self.arrived_s[*at]).collect();
        self.values = order.iter().map(|at| std::mem::take(&mut self.values[*at])).collect();
    }

    fn note_gaps(&self, topic: &Topic, notes: &mut Vec<Note>) {
        let usual_s = usual_step(&self.t_s);
        if usual_s <= 0.0 {
            return;
        }
        let gaps =
            self.t_s.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > GAP_STEPS * usual_s);
        let (mut lost, mut longest_s) = (0.0, 0.0_f64);
        for gap in gaps {
            lost += (gap / usual_s).round() - 1.0;
            longest_s = longest_s.max(gap);
        }
        if lost > 0.0 {
            notes.push(Note::LostMessages { topic: topic.name.clone(), count: lost as usize, longest_s });
        }
    }

    /// One of the values over all samples.
    pub(super) fn channel(&self, at: usize) -> Vec<f64> {
        self.values.iter().map(|values| values[at]).collect()
    }

    /// Returns three adjacent values.
    pub(super) fn triple(&self, at: usize) -> [Vec<f64>; 3] {
        [self.channel(at), self.channel(at + 1), self.channel(at + 2)]
    }
}
