//! Attacks on the sharing of a server, by clients that keep to the protocol: one takes as much as it can, and an honest
//! one from the same address must still be served. Prints its figures.

use std::io::Write as _;
use std::net::{IpAddr, SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crate::net::{Client, PATIENCE, Server, eventually, le, once, request};
use crate::process::Process;
use crazyflie_server::serve::{Limits, SessionEnd, Settings, Shares};
use serde_json::{Value, json};
use tungstenite::Message;

/// Memory that a server under attack may have.
const MOST_MIB: u64 = 512;

fn ask_make(client: &mut Client, num_envs: u32) -> Value {
    client.ask(&json!({"id": 1, "type": "make", "num_envs": num_envs}))
}

fn make(client: &mut Client, num_envs: u32) {
    let made = ask_make(client, num_envs);
    assert_eq!(made["type"], "made", "{made}");
    client.ask_binary(request(2, 1, 0, 0, num_envs, &[]));
}

/// Steps of one environment whose reply is close to the 2 MiB that one message may have.
const LARGE_STEPS: u16 = 8000;

/// Returns the reply to a request for as much as one message may contain: its length, or the code of the refusal.
fn ask_large(client: &mut Client, id: u64) -> Result<usize, String> {
    let actions = vec![0.0; usize::from(LARGE_STEPS) * 4];
    client.ws.send(Message::binary(request(id, 2, 0, LARGE_STEPS, 1, &le(&actions)))).unwrap();
    match client.ws.read().unwrap() {
        Message::Binary(bytes) => Ok(bytes.len()),
        Message::Text(text) => Err(serde_json::from_str::<Value>(&text).unwrap()["code"].to_string()),
        other => panic!("{other:?}"),
    }
}

/// An honest client makes a session and steps it.
fn serve_honest_client(address: SocketAddr, num_envs: u32) {
    let mut honest = Client::connect(address, Some("crazyflie.v1"));
    make(&mut honest, num_envs);
    for id in 3..20 {
        honest.ask_binary(request(id, 2, 0, 1, num_envs, &le(&vec![0.0; num_envs as usize * 4])));
    }
    assert_eq!(honest.ask(&json!({"id": 30, "type": "close"}))["type"], "closed");
}

/// Cut, without a goodbye: the session waits for its client.
fn cut(client: Client) {
    client.ws.get_ref().shutdown(std::net::Shutdown::Both).unwrap();
}

#[test]
fn cut_sessions_with_large_replies_do_not_fill_the_memory() {
    let process = Process::start(&["--log", "error"]);
    let mut most_kib = 0;
    for _ in 0..400 {
        let mut client = process.client();
        make(&mut client, 1);
        ask_large(&mut client, 3).unwrap();
        cut(client);
        most_kib = most_kib.max(process.rss_kib());
    }
    serve_honest_client(process.address, 1024);
    println!("400 cut sessions with a reply of 2 MB each: at most {} MiB", most_kib >> 10);
    assert!(most_kib >> 10 < MOST_MIB, "{most_kib} KiB");
}

#[test]
fn connected_clients_with_large_replies_do_not_fill_the_memory() {
    let process = Process::start(&["--log", "error"]);
    let (mut clients, mut refused) = (Vec::new(), 0);
    for _ in 0..300 {
        let mut client = process.client();
        make(&mut client, 1);
        match ask_large(&mut client, 3) {
            Ok(bytes) => assert!(bytes > 1 << 19, "{bytes} bytes"),
            Err(code) => {
                assert_eq!(code, "\"too_many\"");
                refused += 1;
            }
        }
        clients.push(client);
    }
    let mib = process.rss_kib() >> 10;
    println!("300 connected clients that ask for 2 MB each: {refused} are refused, {mib} MiB");
    assert!(mib < MOST_MIB && refused > 0 && refused < 290, "{mib} MiB, {refused} refused");
    // a small request is served, even from the attacker's address
    serve_honest_client(process.address, 1);
    clients.drain(..50).for_each(cut);
    eventually("room again", || {
        let mut client = process.client();
        make(&mut client, 1);
        ask_large(&mut client, 3).is_ok()
    });
}

#[test]
fn environments_of_cut_sessions_give_way() {
    let process = Process::start(&["--log", "error"]);
    for round in 0..20 {
        let mut client = process.client();
        make(&mut client, 16384);
        cut(client);
        if round % 5 == 4 {
            serve_honest_client(process.address, 1024);
        }
    }
}

#[test]
fn one_address_does_not_take_the_environments_of_all() {
    let limits = Limits {
        envs: Shares { server: 1000, address: 600, token: 600 },
        reserved_envs: Shares::even(0),
        ..Limits::default()
    };
    let server = Server::start(Settings { limits, ..Settings::default() });
    let mut hog = server.connect();
    make(&mut hog, 600);
    let refused = ask_make(&mut server.connect(), 1);
    assert_eq!(refused["code"], "too_many", "{refused}");
    assert!(
        refused["message"].as_str().unwrap().contains("your address has 600 of at most 600"),
        "{refused}"
    );
    let mut other = connect_from([127, 0, 0, 2].into(), server.address);
    make(&mut other, 400);
    assert_eq!(ask_make(&mut connect_from([127, 0, 0, 3].into(), server.address), 1)["code"], "too_many");
    assert_eq!(server.metric("crazyflie_held{resource=\"Environments\"}"), 1000.0);
    assert_eq!(server.metric("crazyflie_limits_reached_total{reason=\"too many environments\"}"), 2.0);
}

/// From another address of this machine.
fn connect_from(from: IpAddr, address: SocketAddr) -> Client {
    use socket2::{Domain, Socket, Type};
    let socket = Socket::new(Domain::IPV4, Type::STREAM, None).unwrap();
    socket.bind(&SocketAddr::new(from, 0).into()).unwrap();
    socket.connect(&address.into()).unwrap();
    let stream = TcpStream::from(socket);
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    Client::over(stream, address, "/ws", Some("crazyflie.v1"))
}

#[test]
fn the_oldest_waiting_session_gives_way_to_the_next() {
    let limits = Limits { parked: Shares { server: 10, address: 2, token: 2 }, ..Limits::default() };
    let server = Server::start(Settings { limits, ..Settings::default() });
    let mut made = Vec::new();
    for _ in 0..3 {
        let mut client = server.connect();
        made.push(ask_make(&mut client, 1));
        cut(client);
        eventually("it waits", || server.metric("crazyflie_connections") <= 1.0);
        std::thread::sleep(Duration::from_millis(20));
    }
    let mut resume = |made: &Value| {
        let message = json!({"id": 1, "type": "resume", "session": made["session"], "token": made["token"]});
        server.connect().ask(&message)["type"].as_str().unwrap().to_owned()
    };
    assert_eq!(made.iter().map(&mut resume).collect::<Vec<_>>(), ["error", "resumed", "resumed"]);
    assert_eq!(server.stop().ended[&SessionEnd::Evicted], 1);
}

#[test]
fn one_client_does_not_take_the_worlds_of_all() {
    let limits = Limits {
        worlds: Shares { server: 5, address: 3, token: 3 },
        reserved_worlds: Shares::even(0),
        world_unpiloted: Duration::from_millis(300),
        ..Limits::default()
    };
    let server = Server::start(Settings { limits, ..Settings::default() });
    let make_world = |client: &mut Client, name: &str| {
        let options = json!({"drones": 2, "max_episode_steps": 100_000});
        client.ask(&json!({"id": 1, "type": "world", "name": name, "mission": "swap", "options": options}))
    };
    let mut hog = server.connect();
    for i in 0..3 {
        assert_eq!(make_world(&mut hog, &format!("hog-{i}"))["type"], "world");
        assert_eq!(hog.ask(&json!({"id": 2, "type": "join", "name": format!("hog-{i}")}))["type"], "joined");
        hog.ask(&json!({"id": 3, "type": "leave"}));
    }
    assert_eq!(make_world(&mut hog, "hog-3")["code"], "too_many");
    let mut other = connect_from([127, 0, 0, 2].into(), server.address);
    assert_eq!(make_world(&mut other, "other")["type"], "world");
    // nobody pilots the three: they end, long before their plan does
    eventually("worlds without pilots end", || make_world(&mut hog, "hog-4")["type"] == "world");
}

#[test]
fn the_work_of_worlds_is_limited() {
    let limits = Limits { world_work: Shares::even(0), ..Limits::default() };
    let server = Server::start(Settings { limits, ..Settings::default() });
    let reply = server.connect().ask(&json!({"id": 1, "type": "world", "name": "mpc", "mission": "swap",
        "options": {"drones": 20}, "autopilot": "mpc"}));
    assert!(
        reply["code"] == "too_many" && reply["message"].as_str().unwrap().contains("thousandths of a core")
    );
}

/// Sends many small requests at once, again and again, until stopped; returns the number answered.
fn pipeline(address: SocketAddr, stop: &AtomicBool, answered: &AtomicU64) {
    let mut client = Client::connect(address, Some("crazyflie.v1"));
    make(&mut client, 1);
    let mut id = 2;
    while !stop.load(Ordering::Relaxed) {
        for _ in 0..64 {
            id += 1;
            client.ws.write(Message::binary(request(id, 2, 0, 1, 1, &le(&[0.0; 4])))).unwrap();
        }
        client.ws.flush().unwrap();
        for _ in 0..64 {
            client.receive_binary();
            answered.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Long requests of a single environment, one after another.
fn ask_for_long(address: SocketAddr, stop: &AtomicBool, answered: &AtomicU64) {
    let mut client = Client::connect(address, Some("crazyflie.v1"));
    make(&mut client, 1);
    let mut id = 2;
    while !stop.load(Ordering::Relaxed) {
        id += 1;
        ask_large(&mut client, id).unwrap();
        answered.fetch_add(u64::from(LARGE_STEPS), Ordering::Relaxed);
    }
}

/// Steps that an honest client, one request at a time, makes in two seconds; and its times in ms, sorted.
fn fly_honestly(address: SocketAddr) -> (u64, Vec<f64>) {
    let mut honest = Client::connect(address, Some("crazyflie.v1"));
    make(&mut honest, 1);
    let (began, mut id, mut times_ms) = (Instant::now(), 2, Vec::new());
    while began.elapsed() < Duration::from_secs(2) {
        id += 1;
        let asked = Instant::now();
        honest.ask_binary(request(id, 2, 0, 1, 1, &le(&[0.0; 4])));
        times_ms.push(asked.elapsed().as_secs_f64() * 1e3);
    }
    times_ms.sort_by(f64::total_cmp);
    (id - 2, times_ms)
}

/// Returns the rate of an honest client beside so many others, and the rate of each of them meanwhile.
fn share(attackers: usize, attack: fn(SocketAddr, &AtomicBool, &AtomicU64)) -> (f64, f64) {
    let process = Process::start(&["--log", "error"]);
    let (alone, _) = fly_honestly(process.address);
    let (stop, answered) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
    let threads: Vec<_> = (0..attackers)
        .map(|_| {
            let (stop, answered, address) = (stop.clone(), answered.clone(), process.address);
            std::thread::spawn(move || attack(address, &stop, &answered))
        })
        .collect();
    std::thread::sleep(Duration::from_millis(300));
    let before = answered.load(Ordering::Relaxed);
    let (beside, times_ms) = fly_honestly(process.address);
    let theirs = (answered.load(Ordering::Relaxed) - before) as f64 / attackers as f64;
    stop.store(true, Ordering::Relaxed);
    threads.into_iter().for_each(|thread| thread.join().unwrap());
    let quantile = |share: f64| times_ms[((times_ms.len() - 1) as f64 * share) as usize];
    println!(
        "{attackers} attackers: the honest client makes {} steps/s alone and {} beside them (p50 {:.2} ms, p99 {:.2} ms), each of them {:.0}",
        alone / 2,
        beside / 2,
        quantile(0.5),
        quantile(0.99),
        theirs / 2.0
    );
    (beside as f64, theirs)
}

#[test]
fn who_pipelines_gets_turns_like_everybody() {
    // its own round trip is the honest client's affair; without turns it got a two-hundredth of what each of the others got
    let fair = once(|| {
        let (honest, theirs) = share(4, pipeline);
        honest > 0.1 * theirs
    });
    assert!(fair, "who pipelines gets more");
}

#[test]
fn long_requests_leave_room_for_short_ones() {
    // in the time of one long request many short ones are answered; without slices it was about one for one
    let fair = once(|| {
        let (honest, their_steps) = share(16, ask_for_long);
        honest > 10.0 * their_steps / f64::from(LARGE_STEPS)
    });
    assert!(fair, "short requests wait for long ones");
}

#[test]
fn a_client_that_never_reads_holds_up_nobody_of_its_address() {
    let process = Process::start(&["--log", "error"]);
    let mut lazy: Vec<Client> = (0..8).map(|_| process.client()).collect();
    for client in &mut lazy {
        make(client, 1);
        let actions = vec![0.0; usize::from(LARGE_STEPS) * 4];
        client.ws.get_mut().set_write_timeout(Some(Duration::from_millis(200))).unwrap();
        for id in 3..10 {
            let _ = client.ws.send(Message::binary(request(id, 2, 0, LARGE_STEPS, 1, &le(&actions))));
        }
        let _ = client.ws.get_mut().flush();
    }
    serve_honest_client(process.address, 64);
}
