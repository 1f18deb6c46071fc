//! The body of the fuzz target `crtp_session`: a client's packets, and the invariants of the drone afterwards. Only
//! tests and cargo-fuzz compile it.

use std::net::{IpAddr, Ipv4Addr};
use std::time::Duration;

use crazyflie_env::config::EffectTable;
use crazyflie_env::model::{Model, VerticalInput};

use crate::packet::Packet;
use crate::simulation::Simulation;
use crate::{LinkQuality, Pace, PositionSource, Settings};

/// Most ticks of an input: more of them find nothing new.
const MAX_TICKS: usize = 200;

/// A session: a byte with the length of a datagram, then the datagram, and so on; a length of 0 is a tick of the
/// simulation. Returns whether anything was answered.
///
/// # Panics
/// If an answer is on another port than its request, or the drone is nowhere afterwards.
pub fn crtp_session(mut bytes: &[u8]) -> bool {
    let settings = Settings {
        model: Model::thesis(),
        vertical: VerticalInput::Thrust,
        effects: EffectTable::new(),
        drones: 1,
        pace: Pace::Lockstep,
        quality: LinkQuality { loss: 0.0, latency: Duration::ZERO },
        seed: 1,
        positions: PositionSource::Script,
        auto_arms: true,
        decks: Vec::new(),
        resets: false,
        host: IpAddr::V4(Ipv4Addr::LOCALHOST),
        port: 0,
        tcp_port: None,
    };
    let mut simulation = Simulation::new(&settings, None).expect("the thesis's model flies");
    let (mut ticks, mut has_answer) = (0, false);
    while let Some((len, rest)) = bytes.split_first() {
        let (datagram, after) = rest.split_at(usize::from(*len).min(rest.len()));
        bytes = after;
        if datagram.is_empty() {
            ticks += 1;
            if ticks <= MAX_TICKS {
                simulation.tick();
            }
        } else if let Some(packet) = Packet::parse(datagram) {
            let answer = crate::simulation::lock(&simulation.boards()[0]).receive(&packet);
            if let Some(answer) = answer {
                assert_eq!((answer.port, answer.channel), (packet.port, packet.channel));
                has_answer = true;
            }
        }
    }
    (0..3).for_each(|_| simulation.tick());
    assert!(simulation.is_finite(), "the drone is nowhere");
    has_answer
}

#[cfg(test)]
#[path = "../../logs/tests/common/damage.rs"]
mod damages;

#[cfg(test)]
mod tests {
    use std::path::Path;

    use proptest::prelude::*;
    use proptest::test_runner::TestRunner;

    use super::*;

    #[test]
    fn sessions_and_damaged_copies_of_them_leave_the_drone_somewhere() {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../fuzz/corpus/crtp_session"));
        let mut paths: Vec<_> =
            std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        paths.sort();
        let files: Vec<Vec<u8>> = paths.iter().map(|path| std::fs::read(path).unwrap()).collect();
        assert!(files.len() >= 3 && files.iter().all(|bytes| crtp_session(bytes)));
        let cases = (0..files.len(), prop::collection::vec(damages::damage(), 1..6));
        let config = ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() };
        let run = TestRunner::new(config).run(&cases, |(which, damages)| {
            let mut bytes = files[which].clone();
            damages.iter().for_each(|damage| damage.apply(&mut bytes));
            crtp_session(&bytes);
            Ok(())
        });
        run.unwrap();
    }

    #[test]
    fn the_target_is_a_program_of_cargo_fuzz() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../fuzz");
        let manifest = std::fs::read_to_string(format!("{folder}/Cargo.toml")).unwrap();
        let program = std::fs::read_to_string(format!("{folder}/fuzz_targets/crtp_session.rs")).unwrap();
        assert!(manifest.contains("name = \"crtp_session\"") && program.contains("fuzzed::crtp_session"));
    }
}
