//! Packets and their answers.

use proptest::prelude::*;

use super::*;

fn ask(board: &mut Board, port: u8, channel: u8, data: &[u8]) -> Option<Vec<u8>> {
    board.receive(&Packet::new(port, channel, data)).map(|answer| answer.data().to_vec())
}

#[test]
fn names_fit_into_a_packet_and_are_one_of_a_kind() {
    for names in [
        PARAMS.iter().map(|param| param.name).collect::<Vec<_>>(),
        LOGS.iter().map(|log| log.name).collect::<Vec<_>>(),
    ] {
        for (i, name) in names.iter().enumerate() {
            // command, id, kind, group, name, two zeros
            assert!(name.len() - 1 + 6 <= crate::packet::MAX_DATA && name.contains('.'), "{name}");
            assert!(!names[..i].contains(name), "{name}");
        }
    }
}

#[test]
fn a_client_can_connect() {
    let mut board = Board::new(0, "cf21", Vec::new(), None, 0);
    assert_eq!(ask(&mut board, 15, 1, &[0]).unwrap()[..18], *b"Bitcraze Crazyflie");
    assert_eq!(ask(&mut board, 13, 1, &[0]).unwrap(), [0, 12]);
    assert_eq!(ask(&mut board, 13, 1, &[2]).unwrap(), b"\x02cf21");
    assert_eq!(ask(&mut board, 5, 1, &[5]).unwrap(), [5, 0, 0]);
    let info = ask(&mut board, 5, 0, &[3]).unwrap();
    assert_eq!(info[1..3], (LOGS.len() as u16).to_le_bytes());
    assert_eq!(ask(&mut board, 5, 0, &[2, 0, 0]).unwrap()[3..], *b"\x07stateEstimate\0x\0");
    assert_eq!(ask(&mut board, 2, 0, &[2, 0xff, 0xff]).unwrap(), [2]);
    assert_eq!(ask(&mut board, 15, 0, b"echo").unwrap(), b"echo");
    assert_eq!(ask(&mut board, 4, 0, &[1]).unwrap(), [1, 2]);
}

#[test]
fn only_decks_that_are_on_are_reported() {
    let id = (index("deck.bcLighthouse4").unwrap() as u16).to_le_bytes();
    for (decks, on) in [(vec![], 0), (vec!["deck.bcFlow2"], 0), (vec!["deck.bcLighthouse4"], 1)] {
        let mut board = Board::new(0, "cf21", decks, None, 0);
        assert_eq!(ask(&mut board, 2, 1, &id).unwrap()[3..], [on]);
    }
}

/// Stored values survive a restart by the power switch; cleared ones do not.
#[test]
fn stored_parameters_survive_a_restart() {
    let mut board = Board::new(0, "cf21", Vec::new(), None, 0);
    let id = (index("velCtlPid.vxKp").unwrap() as u16).to_le_bytes();
    let extra = |board: &mut Board, command: u8| {
        ask(board, 2, 3, &[&[command][..], &id].concat()).unwrap()[3..].to_vec()
    };
    let [default, value] = [25.0_f32, 31.5].map(f32::to_le_bytes);
    assert_eq!(extra(&mut board, 7), [0, 1], "persistent");
    ask(&mut board, 2, 2, &[&id[..], &value].concat()).unwrap();
    assert_eq!(extra(&mut board, 4), [&[0][..], &default].concat());
    assert_eq!(extra(&mut board, 3), [0]);
    assert_eq!(extra(&mut board, 4), [&[1][..], &default, &value].concat());
    board.power(&[0xfe, 0xf0]);
    assert_eq!(board.params.get("velCtlPid.vxKp"), 31.5);
    assert_eq!(extra(&mut board, 5), [0]);
    board.power(&[0xfe, 0xf0]);
    assert_eq!(board.params.get("velCtlPid.vxKp"), 25.0);
    // an order and a serial number cannot be stored
    for name in ["stabilizer.stop", "cpu.id0"] {
        let id = (index(name).unwrap() as u16).to_le_bytes();
        assert_eq!(ask(&mut board, 2, 3, &[&[3][..], &id].concat()).unwrap()[3..], [2], "{name}");
        assert_eq!(ask(&mut board, 2, 3, &[&[7][..], &id].concat()).unwrap()[3..], [0, 0], "{name}");
    }
}

#[test]
fn parameters_are_written_by_id_and_by_name() {
    let mut board = Board::new(3, "cf21", Vec::new(), None, 0);
    let id = (index("posCtlPid.xKp").unwrap() as u16).to_le_bytes();
    let value = 3.5_f32.to_le_bytes();
    let written = ask(&mut board, 2, 2, &[&id[..], &value].concat()).unwrap();
    assert_eq!(written, [&id[..], &value].concat());
    assert_eq!(ask(&mut board, 2, 1, &id).unwrap(), [&id[..], &[0], &value].concat());
    assert_eq!(board.params.gains().position_ps[0], 3.5);
    let named = [b"\0posCtlPid\0xKp\0\x06".as_slice(), &1.5_f32.to_le_bytes()].concat();
    assert_eq!(ask(&mut board, 2, 3, &named).unwrap(), b"\0posCtlPid\0xKp\0\0");
    assert_eq!(board.params.gains().position_ps[0], 1.5);
    let default = ask(&mut board, 2, 3, &[&[8][..], &id].concat()).unwrap();
    assert_eq!(default, [&[8][..], &id, &[0], &2.0_f32.to_le_bytes()].concat());
    let serial = (index("cpu.id0").unwrap() as u16).to_le_bytes();
    assert!(ask(&mut board, 2, 2, &[&serial[..], &[1, 0, 0, 0]].concat()).is_none(), "read only");
    assert_eq!(ask(&mut board, 2, 1, &serial).unwrap()[3], 3);
    ask(&mut board, 15, 3, &[0xfe, 0xf0, 1]);
    assert_eq!(board.params.gains().position_ps[0], 2.0);
}

#[test]
fn a_flood_of_set_points_does_not_drown_an_emergency_stop() {
    let mut board = Board::new(0, "cf21", Vec::new(), None, 0);
    ask(&mut board, 9, 1, &[3]);
    for _ in 0..100_000 {
        ask(&mut board, 7, 0, &[0]);
    }
    let (orders, _) = board.take_orders();
    assert_eq!(orders.len(), MAX_ORDERS);
    assert!(matches!(orders.front(), Some(Order::Emergency)));
}

proptest! {
    #[test]
    fn no_datagram_stops_a_board(
        datagrams in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..33), 1..40)
    ) {
        let mut board = Board::new(0, "cf21", Vec::new(), None, 0);
        for datagram in datagrams {
            if let Some(packet) = Packet::parse(&datagram)
                && let Some(answer) = board.receive(&packet)
            {
                prop_assert_eq!((answer.port, answer.channel), (packet.port, packet.channel));
            }
        }
        let _ = board.take_orders();
        board.show(Telemetry::default());
    }
}
