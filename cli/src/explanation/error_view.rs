//! Errors of prediction as tables show them: axes apart, with their tests.

use crazyflie_identify::explain::errors::{
    AXES, ComponentTable, Errors, ErrorsByComponent, HORIZONS, LEAST_STRETCHES,
};
use crazyflie_identify::explain::signals::{HORIZONS as JUDGED, Signal};
use minijinja::{Value, context};

use super::bars::LogScale;
use super::json::{axis_key, component_key};
use super::view::Cell;
use super::words::{change_percent, significant};
use crate::text::number;

/// Differences of errors with a smaller p value are called one.
const SURE: f64 = 0.05;
/// Horizons of the short tables: 0.5 s, 2 s and the free run.
pub(crate) const SHORT_HORIZONS: [usize; 3] = [JUDGED[0], JUDGED[1], 4];

/// Name and unit of an axis as people read it, and what one of the unit is in SI units.
pub(crate) fn axis_units(axis: usize) -> (&'static str, &'static str, f64) {
    match AXES[axis] {
        (name, "rad") => (name, "deg", 1.0_f64.to_radians()),
        (name, unit) => (name, unit, 1.0),
    }
}

/// A horizon in words.
pub(crate) fn ahead(horizon: usize) -> String {
    match HORIZONS[horizon] {
        "one_step" => "one step".into(),
        name => name.replace('_', " "),
    }
}

/// Errors by axis at some horizons, with their p values.
pub(super) fn tables(errors: &Errors, horizons: &[usize]) -> Vec<Value> {
    (0..AXES.len()).map(|axis| table(errors, axis, horizons)).collect()
}

fn table(errors: &Errors, axis: usize, horizons: &[usize]) -> Value {
    let (name, unit, one) = axis_units(axis);
    let axes = &errors.axes;
    let all = [("before", &axes.before), ("after", &axes.after), ("naive", &axes.naive)]
        .map(|(when, table)| (when, table[axis]));
    let log = LogScale::spanning(all.iter().flat_map(|(_, row)| horizons.iter().map(|h| row[*h])));
    let row = |h: &usize| {
        let pointer = |when: &str| format!("/error/axes/{when}/{}/{}", axis_key(axis), HORIZONS[*h]);
        let [before, after, naive] =
            all.map(|(when, row)| Cell::new(significant(row[*h] / one, 3), row[*h], pointer(when)));
        let (change, p) = (change_percent(all[0].1[*h], all[1].1[*h]), axes.p_value[axis][*h]);
        let class = change.filter(|_| p < SURE).map_or("", |c| if c < 0.0 { "better" } else { "worse" });
        let stretches = axes.stretches[axis][*h];
        let p = Cell::new(p_value(p, stretches), p, pointer("p_value"));
        let change = change.map_or("-".into(), signed_percent);
        let lengths = all.map(|(_, row)| log.length(row[*h]));
        // the class: "better", "worse" or nothing, if chance would do as well
        context!(ahead => ahead(*h), before, after, naive, change, class, p, stretches, lengths)
    };
    context!(axis => name, unit, rows => horizons.iter().map(row).collect::<Vec<_>>())
}

/// A change in percent with its sign.
pub(crate) fn signed_percent(percent: f64) -> String {
    let text = number(percent, if percent.abs() < 9.95 { 1 } else { 0 });
    if percent > 0.0 && text.chars().any(|c| matches!(c, '1'..='9')) {
        format!("+{text} %")
    } else {
        format!("{} %", text.replace('-', "−"))
    }
}

/// A p value, or that there were too few stretches for one.
pub(crate) fn p_value(p: f64, stretches: usize) -> String {
    match p {
        _ if stretches < LEAST_STRETCHES => "too few".into(),
        p if !p.is_finite() => "-".into(),
        p if p < 0.001 => "< 0.001".into(),
        p => number(p, 3),
    }
}

/// Error of a flight in a signal, before and after, 2 s ahead or as far as the flight goes; in the unit of
/// the signal's axis.
pub(crate) fn flight_axis_errors(flight: &ErrorsByComponent, signal: Signal) -> [f64; 2] {
    let error = |table: &ComponentTable, h: usize| {
        signal.components().map(|row| table[row][h].powi(2)).sum::<f64>().sqrt()
    };
    let known = JUDGED.into_iter().rev().find(|h| error(&flight.before, *h).is_finite()).unwrap_or(JUDGED[1]);
    [&flight.before, &flight.after].map(|table| error(table, known))
}

/// The place of an error of a flight in the object for machines.
pub(super) fn flight_pointer(flight: usize, when: &str, component: usize, horizon: usize) -> String {
    format!("/error/flights/{flight}/{when}/{}/{}", component_key(component), HORIZONS[horizon])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_test_of_five_stretches_is_called_too_few_and_of_six_is_none() {
        assert_eq!([p_value(0.01, 5), p_value(0.01, 6), p_value(1e-5, 60)], ["too few", "0.010", "< 0.001"]);
        assert_eq!([p_value(f64::NAN, 0), p_value(f64::NAN, 9)], ["too few", "-"]);
    }
}
