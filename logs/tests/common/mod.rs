//! Helpers of the tests on recorded data.
#![allow(dead_code)] // each test file uses its own part

use std::path::PathBuf;

/// Returns a folder of recorded flights beside the project; the tests that need one are ignored by default.
pub fn data(folder: &str) -> PathBuf {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data")).join(folder);
    assert!(path.is_dir(), "{} not found", path.display());
    path
}

/// A small piece of a recorded flight, see `tests/data/cut.py`.
pub fn piece(file: &str) -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data")).join(file)
}

/// Pearson correlation.
pub fn correlation(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let n = a.len() as f64;
    let (ma, mb) = (a.iter().sum::<f64>() / n, b.iter().sum::<f64>() / n);
    let ab: f64 = a.iter().zip(b).map(|(x, y)| (x - ma) * (y - mb)).sum();
    let aa: f64 = a.iter().map(|x| (x - ma).powi(2)).sum();
    let bb: f64 = b.iter().map(|y| (y - mb).powi(2)).sum();
    ab / (aa * bb).sqrt()
}

/// Slope of `y` over `x` by least squares.
pub fn slope(x: &[f64], y: &[f64]) -> f64 {
    let n = x.len() as f64;
    let (mx, my) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let xy: f64 = x.iter().zip(y).map(|(a, b)| (a - mx) * (b - my)).sum();
    let xx: f64 = x.iter().map(|a| (a - mx).powi(2)).sum();
    xy / xx
}

/// Central differences over `reach` samples to each side, the ends left out: entry 0 belongs to sample
/// `reach`.
pub fn derivative(t: &[f64], x: &[f64], reach: usize) -> Vec<f64> {
    (reach..x.len() - reach).map(|i| (x[i + reach] - x[i - reach]) / (t[i + reach] - t[i - reach])).collect()
}
