//! Levels: every scenario from the easiest to hidden disturbances. The file is level 1.

use super::conditions::{CONDITIONS, Condition};
use super::mystery::EffectPool;
use super::scenario::ScenarioPlan;

/// Level of the files.
pub(super) const AS_DECLARED: usize = 1;

/// Severity of a scenario's adverse conditions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Level {
    /// Number of it in the scenario's name: `hover-aruco.2`.
    pub number: usize,
    /// In a word.
    pub name: &'static str,
    /// Description for users.
    pub about: &'static str,
}

/// All of them, by their numbers.
pub const LEVELS: [Level; 4] = [
    Level {
        number: 0,
        name: "ideal",
        about: "without the camera: the position is known exactly at every tick",
    },
    Level { number: AS_DECLARED, name: "camera", about: "as declared" },
    Level {
        number: 2,
        name: "randomised",
        about: "mass, thrust, attitude gain, drag, gusts and command delay drawn for every flight",
    },
    Level {
        number: 3,
        name: "undeclared",
        about: "besides, one undeclared effect, the same in every flight; its hash is published",
    },
];

/// Every effect of the camera is named so; a test checks this.
const CAMERA: &str = "camera";

/// The plan of a scenario at another level. None where the file hides something already.
pub(super) fn plan_at(level: &Level, declared: &ScenarioPlan, pool: &EffectPool) -> Option<ScenarioPlan> {
    if declared.hidden.is_some() || level.number == AS_DECLARED {
        return None;
    }
    let mut plan = declared.clone();
    plan.name = format!("{}.{}", declared.name, level.number);
    plan.title = format!("{}: {}", declared.title, level.name);
    plan.description = format!("{} Level {}: {}.", declared.description, level.number, level.about);
    match level.number {
        0 => plan.effects.retain(|name, _| !name.starts_with(CAMERA)),
        2 => plan.effects = randomised(declared),
        _ => plan.hidden = Some(pool.without(&declared.effects)),
    }
    Some(plan)
}

/// The effects of the condition of that name; what the scenario declares stays as it is.
fn randomised(declared: &ScenarioPlan) -> crazyflie_env::config::EffectTable {
    let condition = CONDITIONS.iter().find(|condition| condition.name == "randomised");
    let mut effects = condition.map(Condition::table).unwrap_or_default();
    effects.extend(declared.effects.clone());
    effects
}

#[cfg(test)]
mod tests {
    use super::super::scenario;
    use super::super::secrets::Secrets;
    use super::*;
    use crazyflie_env::observation::MARKER_POS;
    use crazyflie_env::vector::STATE;

    #[test]
    fn every_scenario_has_its_levels_and_no_two_are_the_same() {
        let all = scenario::read_all(&Secrets::new(&[1; 32], [2; 32])).unwrap();
        let base = all.iter().filter(|scenario| scenario.level() == AS_DECLARED && scenario.hidden.is_none());
        for scenario in base {
            let name = scenario.plan.name.as_str();
            for level in LEVELS.iter().filter(|level| level.number != AS_DECLARED) {
                let same = all.iter().filter(|other| other.plan.name == format!("{name}.{}", level.number));
                assert_eq!(same.count(), 1, "{name} at level {}", level.number);
            }
        }
        all.iter().for_each(|scenario| drop(scenario.env(1).unwrap()));
        let mut hashes: Vec<_> = all.iter().map(|scenario| scenario.hash()).collect();
        hashes.sort_unstable();
        hashes.dedup();
        assert_eq!(hashes.len(), all.len());
    }

    #[test]
    fn without_the_camera_the_position_is_known_exactly() {
        let all = scenario::read_all(&Secrets::new(&[1; 32], [2; 32])).unwrap();
        for scenario in all.iter().filter(|scenario| scenario.level() == 0 && scenario.drones() == 1) {
            let mut env = scenario.env(2).unwrap();
            let (mut rows, mut states) = (vec![0.0; 2 * env.width()], vec![0.0; 2 * STATE]);
            env.reset(Some(&[3, 4]), None, &mut rows).unwrap();
            env.states(&mut states).unwrap();
            for (row, state) in rows.chunks(env.width()).zip(states.chunks(STATE)) {
                assert_eq!(&row[MARKER_POS.range()], &state[..3], "{}", scenario.id());
            }
        }
    }
}
