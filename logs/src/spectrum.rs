//! The power of a series by frequency. One place: the library's algorithms are compiled where they are first
//! named.

use realfft::RealFftPlanner;

/// Power by bin, from frequency 0 on, of samples at even steps; bin `i` is at `i / (samples * step)`. Empty
/// of fewer than two samples.
pub fn power_spectrum(mut samples: Vec<f64>) -> Vec<f64> {
    if samples.len() < 2 {
        return Vec::new();
    }
    let plan = RealFftPlanner::<f64>::new().plan_fft_forward(samples.len());
    let mut spectrum = plan.make_output_vec();
    match plan.process(&mut samples, &mut spectrum) {
        Ok(()) => spectrum.iter().map(|c| c.norm_sqr()).collect(),
        Err(_) => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_power_of_a_sine_lies_in_its_bin_and_sums_to_its_variance() {
        let samples: Vec<f64> =
            (0..60).map(|i| 3.0 * (std::f64::consts::TAU * 7.0 * f64::from(i) / 60.0).sin()).collect();
        let power = power_spectrum(samples.clone());
        assert_eq!(power.len(), 31);
        // Parseval: twice the power of one side is the sum of squares times the number of samples
        let squares: f64 = samples.iter().map(|x| x * x).sum();
        assert!((2.0 * power[7] / (60.0 * squares) - 1.0).abs() < 1e-12);
        assert!(power.iter().enumerate().all(|(bin, p)| bin == 7 || *p < 1e-20));
        assert!(power_spectrum(vec![1.0]).is_empty());
    }
}
