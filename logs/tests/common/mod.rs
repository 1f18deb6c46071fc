//! What the tests on recorded data share.
#![allow(dead_code)] // each test file uses its own part

use std::io::Write;
use std::path::PathBuf;

/// The folder of recorded flights beside the project, or `None` and a loud line where it is absent.
pub fn data(test: &str, folder: &str) -> Option<PathBuf> {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data")).join(folder);
    if path.is_dir() {
        return Some(path);
    }
    // Straight to the terminal: the test harness hides what `eprintln!` prints in a test that passes.
    let _ = writeln!(std::io::stderr(), "SKIPPED {test}: {} not found", path.display());
    None
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

/// Central differences over `reach` samples to each side, the ends left out: entry 0 belongs to sample `reach`.
pub fn derivative(t: &[f64], x: &[f64], reach: usize) -> Vec<f64> {
    (reach..x.len() - reach).map(|i| (x[i + reach] - x[i - reach]) / (t[i + reach] - t[i - reach])).collect()
}
