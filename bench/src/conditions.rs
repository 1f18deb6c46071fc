//! Conditions that a scenario is flown under: effects besides those that it declares.

use crazyflie_env::config::EffectTable;

/// Effects that are added to those of a scenario.
#[derive(Debug)]
pub struct Condition {
    /// Key in tables.
    pub name: &'static str,
    /// Description for users.
    pub about: &'static str,
    effects: &'static str,
}

/// The ground effect of all conditions: coefficient fitted on small quadrotors (see `crazyflie effects`).
pub const CONDITIONS: [Condition; 3] = [
    Condition {
        name: "nominal",
        about: "the scenario as declared, with ground effect",
        effects: r#"{"ground_effect": {"coefficient": 9}}"#,
    },
    Condition {
        name: "randomised",
        about: "mass, thrust, attitude gain, drag, gusts and command delay drawn for every flight",
        effects: r#"{"ground_effect": {"coefficient": {"uniform": [0, 14]}}, "mass_change": {"uniform": [-0.002, 0.004]},
            "thrust_scale": {"uniform": [0.93, 1.07]}, "attitude_gain": {"uniform": [0.8, 1.2]}, "drag_linear": {"uniform": [0, 0.6]},
            "gust": {"sigma_mps2": {"uniform": [0, 0.4]}, "tau_s": 1}, "cmd_delay": {"uniform": [0, 0.03]}}"#,
    },
    Condition {
        name: "undeclared",
        about: "a centre of mass off centre, of which no controller is told and no randomisation knows",
        effects: r#"{"ground_effect": {"coefficient": 9}, "com_offset": {"roll_deg": 2.5, "pitch_deg": -2}}"#,
    },
];

impl Condition {
    pub(super) fn table(&self) -> EffectTable {
        // a test reads them all
        serde_json::from_str(self.effects).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scenario;

    #[test]
    fn every_condition_is_in_range_and_flies() {
        for condition in &CONDITIONS {
            let table: EffectTable = serde_json::from_str(condition.effects).unwrap();
            crazyflie_env::effects::check_effects(&table).unwrap();
            Scenario::with_effects("fly-80cm", table).unwrap();
        }
    }
}
