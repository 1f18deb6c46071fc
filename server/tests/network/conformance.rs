//! RFC 6455, case by case as the Autobahn suite numbers them (groups 1 to 7, 9 and 10), over raw sockets
//! against the server's echo protocol.

use crate::net::Server;
use crate::raw::{BINARY, CLOSE, CONTINUE, Case, PING, PONG, ServerMessage, TEXT, close, frame, play};
use crazyflie_server::serve::Settings;

fn text(name: &str, payload: &[u8]) -> Case {
    Case::new(name).send(frame(TEXT, payload)).hear(ServerMessage::Text(payload.to_vec()))
}

fn binary(name: &str, payload: &[u8]) -> Case {
    Case::new(name).send(frame(BINARY, payload)).hear(ServerMessage::Binary(payload.to_vec()))
}

/// A message of several frames.
fn parts(opcode: u8, parts: &[&[u8]]) -> Vec<u8> {
    let last = parts.len() - 1;
    let piece = |(i, part): (usize, &&[u8])| {
        frame(if i == 0 { opcode } else { CONTINUE }, part).fin(i == last).bytes()
    };
    parts.iter().enumerate().flat_map(piece).collect()
}

fn framing() -> Vec<Case> {
    let mut cases = vec![];
    for n in [0, 125, 126, 127, 128, 65535, 65536] {
        cases.push(text(&format!("1.1 text of {n}"), &vec![b'*'; n]));
        cases.push(binary(&format!("1.2 binary of {n}"), &vec![0xfe; n]));
    }
    cases.push(text("1.1.8 text of 65536 in chops of 997", &[b'*'; 65536]).chop(997));
    cases.push(binary("1.2.8 binary of 65536 in chops of 997", &[0xfe; 65536]).chop(997));
    cases
}

fn pings() -> Vec<Case> {
    let ping = |name: &str, payload: &[u8]| {
        Case::new(name).send(frame(PING, payload)).hear(ServerMessage::Pong(payload.to_vec()))
    };
    let mut ten = Case::new("2.10 ten pings");
    for i in 0..10 {
        ten = ten.send(frame(PING, format!("payload-{i}").as_bytes()));
    }
    let ten = |name: &str| {
        let mut case = ten.clone().with_name(name);
        // one pong may answer several pings, the last must be answered
        case.hear =
            vec![ServerMessage::Pongs((0..10).map(|i| format!("payload-{i}").into_bytes()).collect())];
        case
    };
    vec![
        ping("2.1 empty", b""),
        ping("2.2 text", b"Hello, world!"),
        ping("2.3 binary", &[0x00, 0xff, 0xfe, 0xfd, 0xfc, 0xfb, 0x00, 0xff]),
        ping("2.4 of 125", &[0xfe; 125]),
        Case::new("2.5 of 126").send(frame(PING, &[0xfe; 126])).fails(1002),
        ping("2.6 of 125, octet by octet", &[0xfe; 125]).chop(1),
        Case::new("2.7 pong unasked for").send(frame(PONG, b"")),
        Case::new("2.8 pong with payload unasked for").send(frame(PONG, b"unsolicited")),
        Case::new("2.9 pong unasked for, then ping")
            .send(frame(PONG, b"unsolicited"))
            .send(frame(PING, b"ping"))
            .hear(ServerMessage::Pong(b"ping".to_vec())),
        ten("2.10 ten pings"),
        ten("2.11 ten pings, octet by octet").chop(1),
    ]
}

fn reserved_bit_cases() -> Vec<Case> {
    let mut cases = vec![];
    for rsv in 1..8 {
        for (kind, opcode) in [("text", TEXT), ("binary", BINARY), ("ping", PING), ("close", CLOSE)] {
            let bad = || frame(opcode, b"ab").rsv(rsv);
            cases.push(Case::new(&format!("3.1 rsv {rsv} in {kind}")).send(bad()).fails(1002));
            let after = text(&format!("3.2 rsv {rsv} in {kind} after a message"), b"Hello").send(bad());
            cases.push(
                after.clone().with_name(&format!("3.3 the same chopped, {}", after.name)).chop(1).fails(1002),
            );
            cases.push(after.fails(1002));
        }
    }
    for opcode in (3..=7).chain(11..=15) {
        for payload in [&b""[..], b"reserved opcode payload"] {
            let name = format!("4 opcode {opcode} with {} bytes", payload.len());
            cases.push(Case::new(&name).send(frame(opcode, payload)).fails(1002));
            cases.push(
                text(&format!("{name} after a message"), b"Hello")
                    .send(frame(opcode, payload))
                    .send(frame(PING, b""))
                    .fails(1002),
            );
        }
    }
    cases.push(
        Case::new("5.1 of RFC: a frame without a mask")
            .send(frame(TEXT, b"Hello").without_mask())
            .fails(1002),
    );
    cases
}

fn fragments() -> Vec<Case> {
    let whole = |name: &str, opcode: u8, pieces: &[&[u8]]| {
        let joined = pieces.concat();
        let heard = if opcode == TEXT { ServerMessage::Text(joined) } else { ServerMessage::Binary(joined) };
        Case::new(name).send(parts(opcode, pieces)).hear(heard)
    };
    let between = |name: &str, pings: usize| {
        let mut case = Case::new(name).send(frame(TEXT, b"fragment1").fin(false));
        for i in 0..pings {
            case = case
                .send(frame(PING, format!("pongme {i}").as_bytes()))
                .hear(ServerMessage::Pong(format!("pongme {i}").into_bytes()));
        }
        case.send(frame(CONTINUE, b"fragment2")).hear(ServerMessage::Text(b"fragment1fragment2".to_vec()))
    };
    let stray = |name: &str, fin: bool, then: Vec<u8>| {
        Case::new(name).send(frame(CONTINUE, b"non-continuation payload").fin(fin)).send(then).fails(1002)
    };
    let mut cases = vec![
        Case::new("5.1 ping in fragments")
            .send(frame(PING, b"fragment1").fin(false))
            .send(frame(CONTINUE, b"fragment2"))
            .fails(1002),
        Case::new("5.2 pong in fragments")
            .send(frame(PONG, b"fragment1").fin(false))
            .send(frame(CONTINUE, b"fragment2"))
            .fails(1002),
        whole("5.3 text in two", TEXT, &[b"fragment1", b"fragment2"]),
        whole("5.4 the same in one write", TEXT, &[b"fragment1", b"fragment2"]).chop(usize::MAX),
        whole("5.5 the same octet by octet", TEXT, &[b"fragment1", b"fragment2"]).chop(1),
        whole("5.3b binary with empty pieces", BINARY, &[b"", b"\x00\xff", b"", b"\x01", b""]),
        whole("6.1.2 three empty pieces", TEXT, &[b"", b"", b""]),
        between("5.6 a ping between", 1),
        between("5.7 the same in one write", 1).chop(usize::MAX),
        between("5.8 the same octet by octet", 1).chop(1),
        between("5.19 two pings between", 2),
        between("5.20 two pings between, octet by octet", 2).chop(1),
        Case::new("5.18 a message within a message")
            .send(frame(TEXT, b"fragment1").fin(false))
            .send(frame(TEXT, b"fragment2"))
            .fails(1002),
        Case::new("5.18b binary within text")
            .send(frame(TEXT, b"fragment1").fin(false))
            .send(frame(BINARY, b"fragment2"))
            .fails(1002),
    ];
    for (i, fin) in [(9, true), (12, false)] {
        let hello = || frame(TEXT, b"Hello, world!").bytes();
        cases.push(stray(&format!("5.{i} continuation of nothing"), fin, hello()));
        cases.push(stray(&format!("5.{} the same in one write", i + 1), fin, hello()).chop(usize::MAX));
        cases.push(stray(&format!("5.{} the same octet by octet", i + 2), fin, hello()).chop(1));
    }
    for (i, fin) in [(15, true), (16, false), (17, true)] {
        let first = whole(
            &format!("5.{i} a message, then continuation of nothing"),
            TEXT,
            &[b"fragment1", b"fragment2"],
        );
        cases.push(
            first.send(frame(CONTINUE, b"fragment3").fin(fin)).send(frame(TEXT, b"fragment4")).fails(1002),
        );
    }
    cases
}

/// Sequences that are no UTF-8, as groups 6.3 and 6.5 to 6.21 have them: overlong, surrogates, truncated, out
/// of range.
const BROKEN: [&[u8]; 27] = [
    b"\xce\xba\xe1\xbd\xb9\xcf\x83\xce\xbc\xce\xb5\xed\xa0\x80edited",
    b"\xce\xba\xe1\xbd\xb9\xcf\x83\xce\xbc\xce\xb5\xf4\x90\x80\x80edited",
    b"\x80",
    b"\xbf",
    b"\x80\xbf",
    b"\x80\xbf\x80\xbf\x80\xbf",
    b"\xc0 \xc1 \xc2 ",
    b"\xe0 \xe1 ",
    b"\xf0 \xf1 ",
    b"\xf8 ",
    b"\xfc ",
    b"\xc0",
    b"\xe0\x80",
    b"\xf0\x80\x80",
    b"\xf8\x80\x80\x80",
    b"\xdf",
    b"\xef\xbf",
    b"\xf7\xbf\xbf",
    b"\xfe",
    b"\xff",
    b"\xfe\xfe\xff\xff",
    b"\xc0\xaf",
    b"\xe0\x80\xaf",
    b"\xf0\x80\x80\xaf",
    b"\xc1\xbf",
    b"\xed\xa0\x80\xed\xb0\x80",
    b"\xf4\x90\x80\x80",
];

fn utf8() -> Vec<Case> {
    let mut cases = vec![];
    let long = "Hello-µ@ßöäüàá-UTF-8!! 微波 🚁 κόσμε \u{ffff}\u{fffe}\u{10ffff}\u{d7ff}\u{e000}\u{0}\u{7f}\u{80}\u{7ff}\u{800}\u{10000}";
    cases.push(text("6.2.1 valid", long.as_bytes()));
    let (a, b) = long.as_bytes().split_at(17);
    cases.push(
        Case::new("6.2.2 valid in two").send(parts(TEXT, &[a, b])).hear(ServerMessage::Text(long.into())),
    );
    let octets: Vec<&[u8]> = long.as_bytes().chunks(1).collect();
    cases.push(
        Case::new("6.2.3 valid, a frame per octet")
            .send(parts(TEXT, &octets))
            .hear(ServerMessage::Text(long.into())),
    );
    for first in
        "\u{0}\u{80}\u{800}\u{10000}\u{7f}\u{7ff}\u{ffff}\u{10ffff}\u{d7ff}\u{e000}\u{fffd}\u{1fffe}\u{2ffff}"
            .chars()
    {
        cases.push(text(&format!("6.6 and 6.22 U+{:04X}", first as u32), first.to_string().as_bytes()));
    }
    for broken in BROKEN {
        cases.push(Case::new(&format!("6.3 {broken:02x?}")).send(frame(TEXT, broken)).fails(1007));
        let octets: Vec<&[u8]> = broken.chunks(1).collect();
        if octets.len() > 1 {
            cases.push(
                Case::new(&format!("6.3 {broken:02x?}, a frame per octet"))
                    .send(parts(TEXT, &octets))
                    .fails(1007),
            );
        }
    }
    let unfinished = frame(TEXT, b"\xce\xba\xf4\x90\x80\x80").fin(false);
    cases.push(Case::new("6.4 told before the message is whole").send(unfinished).fails(1007));
    cases.push(binary("6 binary need not be UTF-8", b"\xff\xfe\xc0"));
    cases
}

fn closing() -> Vec<Case> {
    let goodbye = |name: &str, payload: &[u8], code: Option<u16>| {
        Case::new(name).send(frame(CLOSE, payload)).closes(code)
    };
    let mut cases = vec![
        text("7.1.1 a message, then close", b"Hello World!"),
        Case::new("7.1.2 two closes").send(close(1000, b"")).send(close(1000, b"")).closes(Some(1000)),
        Case::new("7.1.3 ping after close").send(close(1000, b"")).send(frame(PING, b"")).closes(Some(1000)),
        Case::new("7.1.4 message after close")
            .send(close(1000, b""))
            .send(frame(TEXT, b"late"))
            .closes(Some(1000)),
        Case::new("7.1.5 close within a message")
            .send(frame(TEXT, b"a").fin(false))
            .send(close(1000, b""))
            .send(frame(CONTINUE, b"b"))
            .closes(Some(1000)),
        Case::new("7.1.6 a long message, close, ping")
            .send(frame(BINARY, &[7; 262_144]))
            .hear(ServerMessage::Binary(vec![7; 262_144]))
            .send(close(1000, b""))
            .send(frame(PING, b""))
            .closes(Some(1000)),
        goodbye("7.3.1 empty", b"", None),
        goodbye("7.3.2 of one octet", b"\x03", Some(1002)),
        goodbye("7.3.3 code alone", &1000u16.to_be_bytes(), Some(1000)),
        Case::new("7.3.4 with reason").send(close(1000, b"Hello World!")).closes(Some(1000)),
        Case::new("7.3.5 with the longest reason").send(close(1000, &[b'*'; 123])).closes(Some(1000)),
        Case::new("7.3.6 with too long a reason").send(close(1000, &[b'*'; 124])).closes(Some(1002)),
        Case::new("7.5.1 with a reason that is no UTF-8")
            .send(close(1000, b"\xce\xba\xf4\x90\x80\x80"))
            .closes(Some(1007)),
        Case::new("7 close in fragments").send(frame(CLOSE, &1000u16.to_be_bytes()).fin(false)).fails(1002),
    ];
    for code in [1000, 1001, 1002, 1003, 1007, 1008, 1009, 1010, 1011, 3000, 3999, 4000, 4999] {
        cases.push(Case::new(&format!("7.7 code {code}")).send(close(code, b"")).closes(Some(code)));
    }
    for code in [0, 999, 1004, 1005, 1006, 1016, 1100, 2000, 2999, 5000, 65535] {
        cases.push(Case::new(&format!("7.9 code {code}")).send(close(code, b"")).closes(Some(1002)));
    }
    cases
}

fn limits() -> Vec<Case> {
    let mut cases = vec![];
    for kib in [64, 256, 1024, 2048] {
        let payload = vec![0xfe; kib << 10];
        cases.push(binary(&format!("9.2 binary of {kib} KiB"), &payload));
        let pieces: Vec<&[u8]> = payload.chunks(kib << 4).collect();
        cases.push(
            Case::new(&format!("9.4 binary of {kib} KiB in 64 frames"))
                .send(parts(BINARY, &pieces))
                .hear(ServerMessage::Binary(payload.clone())),
        );
    }
    cases.push(text("9.1.1 text of 64 KiB", &[b'*'; 65536]));
    for chop in [64, 256, 1024] {
        cases.push(text(&format!("9.5 text of 64 KiB in chops of {chop}"), &[b'*'; 65536]).chop(chop));
        cases.push(binary(&format!("9.6 binary of 64 KiB in chops of {chop}"), &[3; 65536]).chop(chop));
    }
    for n in [0, 16, 64, 256, 1024] {
        let (mut texts, mut binaries) =
            (Case::new(&format!("9.7 1000 texts of {n}")), Case::new(&format!("9.8 1000 binaries of {n}")));
        for _ in 0..1000 {
            texts = texts.send(frame(TEXT, &vec![b'*'; n])).hear(ServerMessage::Text(vec![b'*'; n]));
            binaries =
                binaries.send(frame(BINARY, &vec![0xfe; n])).hear(ServerMessage::Binary(vec![0xfe; n]));
        }
        cases.extend([texts.chop(usize::MAX), binaries.chop(usize::MAX)]);
    }
    let long = vec![b'*'; 65536];
    let pieces: Vec<&[u8]> = long.chunks(1300).collect();
    cases.push(
        Case::new("10.1.1 text of 64 KiB in frames of 1300")
            .send(parts(TEXT, &pieces))
            .hear(ServerMessage::Text(long.clone())),
    );
    // beyond what the server announces
    cases.push(Case::new("9 text above 64 KiB").send(frame(TEXT, &[b'*'; 65537])).fails(1009));
    cases.push(Case::new("9 binary above 2 MiB").send(frame(BINARY, &vec![1; (2 << 20) + 1])).fails(1009));
    let half = vec![1; 1 << 20];
    cases.push(Case::new("9 fragments above 2 MiB").send(parts(BINARY, &[&half, &half, b"1"])).fails(1009));
    cases.push(
        Case::new("9 a header that claims 2^63")
            .send(vec![0x82, 0xff, 0x7f, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 1, 2, 3, 4])
            .fails(1009),
    );
    cases
}

#[test]
fn every_case_of_the_suite() {
    let server = Server::start(Settings::default());
    let (mut count, mut failures) = (0, vec![]);
    for case in [framing(), pings(), reserved_bit_cases(), fragments(), utf8(), closing(), limits()].concat()
    {
        count += 1;
        if let Err(problem) = play(server.address, &case) {
            failures.push(format!("{}: {problem}", case.name));
        }
    }
    println!("RFC 6455: {count} cases, {} failures", failures.len());
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    assert!(count > 280, "{count} cases");
}

#[test]
fn the_runner_notices_what_is_wrong() {
    let server = Server::start(Settings::default());
    let sent = || Case::new("wrong").send(frame(TEXT, b"a"));
    for (case, problem) in [
        (sent().hear(ServerMessage::Text(b"b".to_vec())), "another echo"),
        (sent(), "an echo that is not expected"),
        (sent().hear(ServerMessage::Binary(b"a".to_vec())), "another opcode"),
        (
            sent().hear(ServerMessage::Text(b"a".to_vec())).hear(ServerMessage::Pong(vec![])),
            "a pong that does not come",
        ),
        (
            sent().hear(ServerMessage::Text(b"a".to_vec())).send(close(1001, b"")).closes(Some(1000)),
            "another code",
        ),
        (Case::new("wrong").send(frame(TEXT, b"\xff")).fails(1002), "1007 where 1002 is expected"),
    ] {
        assert!(play(server.address, &case).is_err(), "{problem} was not noticed");
    }
}
