//! Counter-based noise: a draw is a pure function of (episode key, tick, channel), so it does not depend on
//! the batch size, the number of threads, or on which other effects draw.

use crate::scalar::{Scalar, Word};

/// Bijective 32-bit mixing with low bias; constants from the search of C. Wellons, "Prospecting for hash
/// functions" (2018).
#[inline(always)]
fn mix<W: Word>(x: W) -> W {
    let x = (x ^ x.shr(16)).mul(W::from_u32(0x7feb_352d));
    let x = (x ^ x.shr(15)).mul(W::from_u32(0x846c_a68b));
    x ^ x.shr(16)
}

/// 64-bit finaliser of splitmix64 (Steele, Lea, Flood 2014): seeds that differ by one bit give unrelated
/// keys.
pub fn scramble(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// The key of one episode of one environment.
pub fn episode_key(seed: u64, episode: u64) -> u64 {
    scramble(scramble(seed) ^ episode.wrapping_mul(0xd1b5_4a32_d192_ed03))
}

/// The key of one drone's noise: drones of a world must not shake together.
pub(crate) fn drone_key(episode: u64, drone: usize) -> u64 {
    scramble(episode ^ (drone as u64 + 1).wrapping_mul(0x9fb2_1c65_1e98_df25))
}

/// A name as a channel number (FNV-1a): an effect keeps its noise whatever else is in the registry.
pub const fn channel(name: &str) -> u32 {
    let (bytes, mut hash, mut i) = (name.as_bytes(), 0x811c_9dc5_u32, 0);
    while i < bytes.len() {
        hash = (hash ^ bytes[i] as u32).wrapping_mul(0x0100_0193);
        i += 1;
    }
    hash
}

/// The episode keys of a tile's lanes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EpisodeKeys<R: Scalar> {
    low: R::Word,
    high: R::Word,
}

impl<R: Scalar> EpisodeKeys<R> {
    pub fn new() -> Self {
        EpisodeKeys { low: R::Word::from_u32(0), high: R::Word::from_u32(0) }
    }
    pub fn set_lane(&mut self, lane: usize, key: u64) {
        self.low.set_lane(lane, key as u32);
        self.high.set_lane(lane, (key >> 32) as u32);
    }
    /// Keys that are words already: low, then high.
    #[cfg(feature = "recording")]
    pub fn from_words([low, high]: [R::Word; 2]) -> Self {
        EpisodeKeys { low, high }
    }
    /// Returns the random numbers of one tick.
    #[inline(always)]
    pub fn draw<'a>(&'a self, tick: &'a R::Word) -> TickRng<'a, R> {
        TickRng { keys: self, tick }
    }
}

/// The draws of one tick. The same channel gives the same number; take a new channel for a new number.
#[derive(Clone, Copy, Debug)]
pub struct TickRng<'a, R: Scalar> {
    keys: &'a EpisodeKeys<R>,
    tick: &'a R::Word,
}

impl<R: Scalar> TickRng<'_, R> {
    /// Uniform in (0, 1).
    #[inline(always)]
    pub fn uniform(&self, channel: u32) -> R {
        if R::MEAN {
            return R::from_f64(0.5);
        }
        R::unit(self.word(channel))
    }
    /// Two independent standard normals (Box and Muller 1958); reaches 5.6 standard deviations.
    #[inline(always)]
    pub fn normals(&self, channel: u32) -> [R; 2] {
        if R::MEAN {
            return [R::zero(); 2];
        }
        let radius = (R::from_f64(-2.0) * self.uniform(channel).ln()).sqrt();
        let turn = self.uniform(channel ^ 0x8000_0000) - R::from_f64(0.5);
        // sine and cosine of 2 pi turn, from the angle to the vertical, which is within a quarter turn
        let a = R::from_f64(std::f64::consts::TAU) * (turn.abs() - R::from_f64(0.25));
        let (sin_a, cos_a) = a.sin_cos_quarter();
        let s = R::select(turn.lt(R::zero()), -cos_a, cos_a);
        let c = -sin_a;
        [radius * c, radius * s]
    }
    /// 32 random bits.
    #[inline(always)]
    pub(crate) fn word(&self, channel: u32) -> R::Word {
        let base = mix(self.tick.mul(R::Word::from_u32(0x9e37_79b9)).add(self.keys.low)) ^ self.keys.high;
        mix(base.add(R::Word::from_u32(channel.wrapping_mul(0x85eb_ca6b))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(n: u32, channel: u32) -> Vec<f64> {
        let mut keys = EpisodeKeys::<f64>::new();
        (0..n)
            .flat_map(|i| {
                keys.set_lane(0, episode_key(u64::from(i / 500), 3));
                keys.draw(&(i % 500)).normals(channel)
            })
            .collect()
    }

    fn mean(x: impl IntoIterator<Item = f64>, n: usize) -> f64 {
        x.into_iter().sum::<f64>() / n as f64
    }

    #[test]
    fn normals_have_the_moments_of_a_normal() {
        let x = sample(200_000, 7);
        let n = x.len();
        let m = |p: i32| mean(x.iter().map(|v| v.powi(p)), n);
        assert!(
            m(1).abs() < 0.01 && (m(2) - 1.0).abs() < 0.015 && m(3).abs() < 0.03 && (m(4) - 3.0).abs() < 0.08,
            "{} {} {} {}",
            m(1),
            m(2),
            m(3),
            m(4)
        );
    }

    #[test]
    fn neighbouring_ticks_channels_and_episodes_are_uncorrelated() {
        let (a, b) = (sample(100_000, 7), sample(100_000, 8));
        let n = a.len();
        let cross = mean(a.iter().zip(&b).map(|(x, y)| x * y), n);
        let lag = mean(a.iter().zip(&a[2..]).map(|(x, y)| x * y), n - 2);
        let pair = mean(a.chunks(2).map(|p| p[0] * p[1]), n / 2);
        assert!(cross.abs() < 0.01 && lag.abs() < 0.01 && pair.abs() < 0.012, "{cross} {lag} {pair}");
    }

    #[test]
    fn keys_spread() {
        let mut seen: Vec<u64> = (0..1000).flat_map(|s| (0..20).map(move |e| episode_key(s, e))).collect();
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), 20_000);
    }
}
