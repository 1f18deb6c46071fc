//! Statistics of samples, and tests of the residuals of a model. Every crate that needs a median or a test
//! takes it from here.
#![forbid(unsafe_code)]

mod residuals;

pub use residuals::{
    CONFIDENCE, Criteria, Independence, LAGS, StatisticsError, Whiteness, criteria, independence,
    paired_bound, paired_p_value, whiteness,
};

/// Arithmetic mean; none of no samples.
pub fn mean(samples: &[f64]) -> Option<f64> {
    (!samples.is_empty()).then(|| samples.iter().sum::<f64>() / samples.len() as f64)
}

/// Root of the mean square; none of no samples.
pub fn rms(samples: &[f64]) -> Option<f64> {
    (!samples.is_empty()).then(|| (samples.iter().map(|v| v * v).sum::<f64>() / samples.len() as f64).sqrt())
}

/// Midpoint of the two middle samples of an even number; none of no samples.
pub fn median(samples: &[f64]) -> Option<f64> {
    let sorted = sorted(samples);
    let (low, high) = (sorted.get(sorted.len().checked_sub(1)? / 2)?, sorted.get(sorted.len() / 2)?);
    Some(f64::midpoint(*low, *high))
}

/// The sample with a `share` of all below it, so a value that occurred; none of no samples.
pub fn quantile(samples: &[f64], share: f64) -> Option<f64> {
    let sorted = sorted(samples);
    let rank = (share * sorted.len() as f64) as usize;
    sorted.get(rank.min(sorted.len().checked_sub(1)?)).copied()
}

fn sorted(samples: &[f64]) -> Vec<f64> {
    let mut sorted = samples.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summaries_of_samples_and_of_none() {
        assert_eq!(
            [mean(&[1.0, 2.0, 6.0]), rms(&[3.0, 4.0, 5.0]).map(|r| r * r)],
            [Some(3.0), Some(50.0 / 3.0)]
        );
        assert_eq!(
            [median(&[]), median(&[3.0]), median(&[8.0, 1.0, 3.0]), median(&[8.0, 3.0, 1.0, 4.0])],
            [None, Some(3.0), Some(3.0), Some(3.5)]
        );
        assert_eq!(
            [0.0, 0.5, 1.0].map(|share| quantile(&[3.0, 1.0, 2.0], share)),
            [Some(1.0), Some(2.0), Some(3.0)]
        );
        assert_eq!([mean(&[]), rms(&[]), quantile(&[], 0.5)], [None; 3]);
    }
}
