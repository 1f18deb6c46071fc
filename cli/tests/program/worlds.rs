//! Shared worlds over real sockets: lock-step to the bit, deadlines, joining and leaving, the log, mistakes.

use std::time::{Duration, Instant};

use crate::fleet::Fleet;
use crate::net::{Client, Server, eventually, floats};
use crazyflie_server::serve::{Limits, Settings, Shares};
use serde_json::{Value, json};

/// Noise everywhere, so that bits depend on everything.
fn options(drones: usize, steps: u32) -> Value {
    let effects = json!({"gust": {"sigma_mps2": 0.3}, "camera_noise": 0.01});
    json!({"drones": drones, "effects": effects, "max_episode_steps": steps})
}

fn create_world(client: &mut Client, name: &str, more: Value) -> Value {
    let mut ask = json!({"id": 1, "type": "world", "name": name, "mission": "swap", "options": options(4, 150), "seed": 7, "deadline_s": 10});
    ask.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
    client.ask(&ask)
}

fn join(client: &mut Client, name: &str, drone: Option<usize>) -> Value {
    client.ask(&json!({"id": 2, "type": "join", "name": name, "drone": drone}))
}

fn fly(client: &mut Client, action: [f32; 4]) -> Value {
    client.ask(&json!({"id": 3, "type": "fly", "action": action.map(f64::from)}))
}

/// Small tilts about a height of some 80 cm, different for each drone and tick.
fn action(tick: usize, drone: usize) -> [f32; 4] {
    let wave = |k: usize| (((tick * 31 + drone * 17 + k * 7) % 41) as f32 / 20.5 - 1.0) * 0.2;
    [wave(0), wave(1), wave(2), 0.07 + 0.1 * wave(3)]
}

fn row(reply: &Value) -> Vec<u32> {
    reply["observation"].as_array().unwrap().iter().map(|n| (n.as_f64().unwrap() as f32).to_bits()).collect()
}

fn worlds(server: &Server) -> Vec<Value> {
    serde_json::from_str(&server.get("/api/v1/worlds")).unwrap()
}

fn world(server: &Server, name: &str) -> Value {
    worlds(server).into_iter().find(|row| row["world"] == name).unwrap()
}

/// The log of a world in a file, and what `replay-world` makes of it.
fn replay_world(server: &Server, name: &str) -> (String, Value) {
    let text = server.get(&format!("/api/v1/worlds/{name}/log"));
    let file = crate::common::folder(&format!("world-{name}")).join("log.jsonl");
    std::fs::write(&file, &text).unwrap();
    (text, crate::common::json(&["world", "replay", crate::common::text(&file), "--json"]))
}

#[test]
fn four_clients_in_lock_step_get_the_bits_of_the_library() {
    const TICKS: usize = 150;
    let server = Server::start(Settings::default());
    let mut host = server.connect();
    let reply = create_world(&mut host, "four", json!({"pilots": 4}));
    assert_eq!(
        (&reply["type"], &reply["drones"], &reply["width"]),
        (&json!("world"), &json!(4), &json!(48)),
        "{reply}"
    );
    let began = Instant::now();
    let pilots: Vec<_> = (0..4)
        .map(|drone| {
            let mut client = server.connect();
            std::thread::spawn(move || {
                let joined = join(&mut client, "four", Some(drone));
                assert_eq!(
                    (&joined["type"], &joined["drone"], &joined["tick"]),
                    (&json!("joined"), &json!(drone), &json!(0)),
                    "{joined}"
                );
                let mut rows = vec![(row(&joined), 0, true)];
                for tick in 0..TICKS {
                    let flown = fly(&mut client, action(tick, drone));
                    assert_eq!(flown["tick"], tick + 1, "{flown}");
                    let reward = (flown["reward"].as_f64().unwrap() as f32).to_bits();
                    let flying = flown["flying"].as_bool().unwrap();
                    rows.push((row(&flown), reward, flying));
                    if !flying {
                        break;
                    }
                }
                rows
            })
        })
        .collect();
    let rows: Vec<_> = pilots.into_iter().map(|pilot| pilot.join().unwrap()).collect();
    let wall_s = began.elapsed().as_secs_f64();

    let mut all = options(4, 150);
    all["task"] = "swap".into();
    all["autoreset"] = "disabled".into();
    let mut fleet = Fleet::new(1, &all.to_string());
    fleet.reset(7);
    let mut compared = 0;
    for tick in 0..=TICKS {
        let seen: Vec<_> = fleet
            .observations
            .chunks(48)
            .map(|row| row.iter().map(|n| n.to_bits()).collect::<Vec<_>>())
            .collect();
        for (drone, rows) in rows.iter().enumerate() {
            if let Some((observation, reward, flying)) = rows.get(tick) {
                assert_eq!(observation, &seen[drone], "drone {drone}, tick {tick}");
                assert!(
                    tick == 0
                        || (*reward == fleet.rewards[drone].to_bits() && *flying == fleet.flying[drone]),
                    "tick {tick}"
                );
                compared += 48;
            }
        }
        if tick < TICKS && fleet.flying.contains(&true) {
            let actions: Vec<f32> = (0..4).flat_map(|drone| action(tick, drone)).collect();
            fleet.step(&actions).unwrap();
        }
    }
    let lengths: Vec<_> = rows.iter().map(|rows| rows.len() - 1).collect();
    println!(
        "four clients: ticks {lengths:?}, {compared} numbers equal bit for bit; {:.0} ticks/s",
        lengths[0] as f64 / wall_s
    );
    assert!(lengths.iter().all(|n| *n >= 40), "{lengths:?}");
    let (_, again) = replay_world(&server, "four");
    assert_eq!((&again["told"], &again["flown"]["over"]), (&again["flown"], &json!(true)));
}

#[test]
fn who_is_late_is_counted_and_stops_nobody() {
    let server = Server::start(Settings::default());
    let (mut quick, mut slow) = (server.connect(), server.connect());
    create_world(&mut quick, "late", json!({"pilots": 2, "deadline_s": 0.02, "options": options(3, 400)}));
    join(&mut quick, "late", Some(0));
    join(&mut slow, "late", Some(1));
    // one action of its own, then silence
    slow.send(&json!({"id": 3, "type": "fly", "action": [0.05, 0, 0, 0.07]}));
    let began = Instant::now();
    // on a busy machine it may be late itself
    let mut ticks = 0;
    while ticks < 40 {
        let flown = fly(&mut quick, action(ticks, 0));
        assert_eq!(flown["flying"], true, "{flown}");
        ticks = flown["tick"].as_u64().unwrap() as usize;
    }
    let wall_s = began.elapsed().as_secs_f64();
    slow.receive();
    let late = fly(&mut slow, action(41, 1));
    let counted = late["late"].as_u64().unwrap();
    println!(
        "{ticks} ticks beside a silent pilot took {wall_s:.2} s with a deadline of 0.02 s; it was late {counted} times"
    );
    assert!(counted >= 38 && wall_s > 0.02 * 38.0, "{late}");
    drop((quick, slow));
    let (text, again) = replay_world(&server, "late");
    let ticks: Vec<Value> = text.lines().skip(1).map(|line| serde_json::from_str(line).unwrap()).collect();
    let held = ticks.iter().filter(|tick| tick["by"][1] == "late");
    let held: Vec<_> = held.map(|tick| tick["actions"][1].clone()).collect();
    assert!(
        held.len() as u64 >= counted && held[..38].iter().all(|a| a[0] == json!(f64::from(0.05_f32))),
        "it holds its last command"
    );
    assert_eq!(again["told"], again["flown"]);
}

#[test]
fn pilots_come_and_go() {
    let server = Server::start(Settings::default());
    let (mut a, mut b) = (server.connect(), server.connect());
    create_world(&mut a, "open", json!({"deadline_s": 10, "options": options(2, 5000)}));
    let first = join(&mut a, "open", None);
    assert_eq!((&first["drone"], &first["tick"]), (&json!(0), &json!(0)));
    (0..5).for_each(|tick| assert_eq!(fly(&mut a, action(tick, 0))["tick"], tick + 1));
    let second = join(&mut b, "open", None);
    assert_eq!(
        (&second["drone"], &second["tick"]),
        (&json!(1), &json!(5)),
        "a late joiner begins where the world is"
    );
    assert_eq!(world(&server, "open")["by"], json!(["pilot", "pilot"]));
    // one connection is cut; the autopilot takes its drone, and the world does not wait
    drop(b);
    eventually("the autopilot has the drone", || world(&server, "open")["by"][1] == "autopilot");
    let began = Instant::now();
    (5..15).for_each(|tick| assert_eq!(fly(&mut a, action(tick, 0))["tick"], tick + 1));
    let alone_s = began.elapsed().as_secs_f64();
    let mut b = server.connect();
    assert_eq!(join(&mut b, "open", Some(1))["tick"], 15, "it may come back");
    // a connection that does not know it is dead is taken over
    let mut c = server.connect();
    assert_eq!(join(&mut c, "open", Some(1))["code"], "drone_taken");
    let token = first["token"].clone();
    let again = c.ask(&json!({"id": 4, "type": "join", "name": "open", "drone": 0, "token": token}));
    assert_eq!(again["type"], "joined", "{again}");
    assert_eq!(fly(&mut a, action(0, 0))["code"], "seat_lost");
    // without anybody it flies on in real time
    assert_eq!(c.ask(&json!({"id": 9, "type": "leave"}))["type"], "left");
    assert_eq!(b.ask(&json!({"id": 9, "type": "leave"}))["type"], "left");
    let before = world(&server, "open")["ticks"].as_u64().unwrap();
    eventually("the autopilot flies on", || world(&server, "open")["ticks"].as_u64().unwrap() >= before + 20);
    println!(
        "joined at tick 5, lost, flown on ({:.2} ms a tick), joined again at 15; {before} ticks with pilots",
        100.0 * alone_s
    );
    assert!(alone_s < 100.0, "nobody waits for who is gone");
    let (_, again) = replay_world(&server, "open");
    assert_eq!(again["told"], again["flown"]);
    assert!(again["flown"]["ticks"].as_u64().unwrap() >= before);
}

#[test]
fn a_log_is_flown_again_to_the_same_bits_and_another_one_is_not() {
    let server = Server::start(Settings::default());
    let mut client = server.connect();
    create_world(&mut client, "logged", json!({"options": options(4, 60), "seed": 11}));
    join(&mut client, "logged", Some(2));
    (0..60).for_each(|tick| drop(fly(&mut client, action(tick, 2))));
    let row = world(&server, "logged");
    assert_eq!((&row["over"], &row["ticks"], &row["seed"]), (&json!(true), &json!(60), &json!(11)), "{row}");
    let (text, again) = replay_world(&server, "logged");
    assert_eq!((&again["told"]["sha256"], &again["flown"]["sha256"]), (&row["sha256"], &row["sha256"]));
    println!("60 ticks of 4 drones, {} bytes of log, SHA-256 {} twice", text.len(), row["sha256"]);
    // the smallest change of one action is seen
    let mut lines: Vec<String> = text.lines().map(String::from).collect();
    let mut tick: Value = serde_json::from_str(&lines[30]).unwrap();
    let number = tick["actions"][1][0].as_f64().unwrap() as f32;
    tick["actions"][1][0] = f64::from(number.next_down().clamp(-1.0, 1.0)).into();
    lines[30] = tick.to_string();
    let file = crate::common::folder("world-changed").join("log.jsonl");
    std::fs::write(&file, lines.join("\n")).unwrap();
    crate::common::assert_fails(
        1,
        &["world", "replay", crate::common::text(&file)],
        &["not the one that the log tells of"],
    );
    lines.truncate(20);
    std::fs::write(&file, lines.join("\n")).unwrap();
    crate::common::assert_fails(1, &["world", "replay", crate::common::text(&file)], &["no last line"]);
    lines[7] = "{}".into();
    std::fs::write(&file, lines.join("\n")).unwrap();
    crate::common::assert_fails(
        1,
        &["world", "replay", crate::common::text(&file)],
        &["line 8", "expected actions and by"],
    );
}

#[test]
fn a_watcher_sees_all_drones_and_how_near_they_are() {
    let server = Server::start(Settings::default());
    let mut client = server.connect();
    let reply = create_world(&mut client, "seen", json!({"options": options(3, 200)}));
    let mut live = Client::connect_at(server.address, "/live", Some("crazyflie.live.v1"));
    live.send(&json!({"watch": reply["session"]}));
    let head = live.receive_binary();
    let length = u32::from_le_bytes(head[..4].try_into().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&head[4..4 + length]).unwrap();
    assert_eq!(
        (&header["drones"], &header["world"], header["columns"].as_array().unwrap().len()),
        (&json!(3), &json!("seen"), 28)
    );
    join(&mut client, "seen", None);
    let rows = loop {
        fly(&mut client, action(0, 0));
        let rows = floats(&live.receive_binary());
        if rows[0] > 0.1 {
            break rows;
        }
    };
    assert_eq!(rows.len(), 3 * 28);
    let rows: Vec<&[f32]> = rows.chunks(28).collect();
    let apart = |a: usize, b: usize| (1..4).map(|i| (rows[a][i] - rows[b][i]).powi(2)).sum::<f32>().sqrt();
    for (own, [b, c]) in [[1, 2], [0, 2], [0, 1]].into_iter().enumerate() {
        assert_eq!((rows[own][25], rows[own][26]), (1.0, apart(own, b).min(apart(own, c))));
    }
    let (now, least) = (rows.iter().map(|row| row[26]).fold(f32::INFINITY, f32::min), rows[0][27]);
    println!("three drones, {now:.3} m apart now, {least:.3} m at least so far");
    assert!(least <= now && least > 1.0, "{now} {least}");
    let listed: Value = serde_json::from_str(&server.get("/api/v1/sessions")).unwrap();
    assert_eq!(
        (&listed[0]["drones"], &listed[0]["num_envs"], &listed[0]["world"]),
        (&json!(3), &json!(1), &json!("seen"))
    );
}

#[test]
fn mistakes_are_told_and_the_others_fly_on() {
    let limits = Limits {
        worlds: Shares::even(2),
        reserved_worlds: Shares::even(0),
        world_waits: Duration::from_secs(5),
        ..Limits::default()
    };
    let server = Server::start(Settings { limits, ..Settings::default() });
    let (mut a, mut b) = (server.connect(), server.connect());
    let code = |reply: Value| reply["code"].as_str().unwrap_or_else(|| panic!("{reply}")).to_owned();
    for (wrong, want) in [
        (json!({"mission": "swop"}), "bad_options"),
        (json!({"name": "a/b"}), "bad_name"),
        (json!({"deadline_s": 0}), "bad_options"),
        (json!({"pilots": 5}), "bad_options"),
        (json!({"autopilot": "pid:/etc/passwd"}), "bad_options"),
        (json!({"options": {"drones": 65}}), "bad_options"),
        (json!({"options": {"max_episode_steps": 0}}), "bad_options"),
        (json!({"options": {"drones": 64, "max_episode_steps": 4_000_000}}), "bad_options"),
        (json!({"options": {"autoreset": "same_step"}}), "bad_options"),
        (json!({"model": "nothing"}), "bad_model"),
        (json!({"seed": -1}), "bad_message"),
    ] {
        let reply = create_world(&mut a, "one", wrong.clone());
        assert_eq!(reply["code"], want, "{wrong}: {reply}");
    }
    assert_eq!(code(join(&mut a, "one", None)), "unknown_world");
    assert_eq!(code(fly(&mut a, [0.0; 4])), "no_seat");
    assert_eq!(code(a.ask(&json!({"id": 1, "type": "leave"}))), "no_seat");
    create_world(&mut a, "one", json!({"options": options(2, 3000)}));
    assert_eq!(code(create_world(&mut b, "one", json!({}))), "world_taken");
    assert_eq!(code(join(&mut b, "one", Some(2))), "unknown_drone");
    join(&mut a, "one", Some(0));
    assert_eq!(code(join(&mut a, "one", Some(1))), "bad_message");
    assert_eq!(code(join(&mut b, "one", Some(0))), "drone_taken");
    assert_eq!(join(&mut b, "one", None)["drone"], 1);
    let mut c = server.connect();
    assert_eq!(code(join(&mut c, "one", None)), "no_free_drone");
    for (wrong, want) in [
        ("[0,0,0]", "wrong_length"),
        ("[0,0,0,0,0]", "wrong_length"),
        ("[0,0,0,1.5]", "bad_action"),
        ("[0,0,0,null]", "bad_message"),
        ("[0,0,0,NaN]", "bad_json"),
        ("[0,0,0,1e999]", "bad_message"),
    ] {
        a.ws.send(tungstenite::Message::text(format!(r#"{{"id": 5, "type": "fly", "action": {wrong}}}"#)))
            .unwrap();
        assert_eq!(code(a.receive()), want, "{wrong}");
    }
    // one drone falls to the floor; its pilot is told, the other one flies on
    let falling = std::thread::spawn(move || {
        let mut last = fly(&mut a, [0.0, 0.0, 0.0, -1.0]);
        while last["flying"] == true {
            last = fly(&mut a, [0.0, 0.0, 0.0, -1.0]);
        }
        (fly(&mut a, [0.0; 4]), last)
    });
    let mut ticks = 0;
    while !falling.is_finished() || ticks < 200 {
        let flown = fly(&mut b, [0.0, 0.0, 0.0, 0.07]);
        assert_eq!(flown["flying"], true, "{flown}");
        ticks += 1;
    }
    let (refused, last) = falling.join().unwrap();
    assert_eq!(
        (&last["terminated"], &refused["code"]),
        (&json!(true), &json!("drone_ended")),
        "{last} {refused}"
    );
    assert_eq!(code(join(&mut c, "one", Some(0))), "drone_ended");
    println!("one drone ended at tick {}, the other one flew on to {ticks}", last["tick"]);
    // a world for which nobody comes is over, and its name free
    create_world(&mut c, "two", json!({}));
    assert_eq!(code(create_world(&mut c, "three", json!({}))), "too_many");
    eventually("nobody came", || {
        world(&server, "two")["ticks"] == 0 && create_world(&mut c, "two", json!({}))["type"] == "world"
    });
}

#[test]
fn joining_by_invitation_needs_the_word() {
    let server = Server::start(Settings::default());
    let (mut host, mut guest) = (server.connect(), server.connect());
    assert_eq!(create_world(&mut host, "private", json!({"invitation": "open sesame"}))["type"], "world");
    let ask = |client: &mut Client, word: Value| {
        client.ask(&json!({"id": 2, "type": "join", "name": "private", "invitation": word}))
    };
    for wrong in [json!(null), json!(""), json!("Open sesame"), json!("open sesame ")] {
        let reply = ask(&mut guest, wrong.clone());
        assert!(
            reply["code"] == "not_invited" && !reply.to_string().contains("open sesame"),
            "{wrong}: {reply}"
        );
    }
    assert_eq!(ask(&mut guest, json!("open sesame"))["type"], "joined");
    assert!(!server.get("/api/v1/worlds").contains("open sesame"));
    assert!(!server.get("/api/v1/worlds/private/log").contains("open sesame"));
    assert_eq!(create_world(&mut host, "empty", json!({"invitation": ""}))["code"], "bad_options");
}

#[test]
fn a_silent_pilot_loses_its_drone() {
    let limits = Limits { pilot_silence: Duration::from_secs(4), ..Limits::default() };
    let server = Server::start(Settings { limits, ..Settings::default() });
    let (mut busy, mut silent) = (server.connect(), server.connect());
    create_world(&mut busy, "room", json!({"options": options(2, 3000), "deadline_s": 0.02, "pilots": 2}));
    let began = Instant::now();
    join(&mut busy, "room", Some(0));
    join(&mut silent, "room", Some(1));
    eventually("the silent one loses it", || {
        assert_eq!(fly(&mut busy, [0.0, 0.0, 0.0, 0.07])["type"], "flown");
        world(&server, "room")["by"][1] == "autopilot"
    });
    assert!(began.elapsed() >= Duration::from_secs(4));
    assert_eq!(fly(&mut silent, [0.0; 4])["code"], "seat_lost");
    assert_eq!(join(&mut server.connect(), "room", Some(1))["type"], "joined");
}

#[test]
fn pilots_that_start_before_the_world_wait_for_it() {
    let server = Server::start(Settings::default());
    let url = format!("ws://{}", server.address);
    let join = |more: &[&str]| {
        let mut command = std::process::Command::new(crate::common::BINARY);
        command.args(["world", "join", "--server", &url, "--world", "late", "--json"]).args(more);
        command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
        command.spawn().unwrap()
    };
    let refused = join(&[]).wait_with_output().unwrap();
    assert!(!refused.status.success() && String::from_utf8_lossy(&refused.stderr).contains("late"));
    let pilots: Vec<_> =
        ["0", "1"].map(|drone| join(&["--drone", drone, "--wait", "300", "--collision-avoidance"])).into();
    let options = r#"{"drones": 2, "max_episode_steps": 40}"#;
    let arguments =
        ["world", "found", "--server", &url, "--world", "late", "--mission", "swap", "--options", options];
    let text = crate::common::stdout_of(&[&arguments[..], &["--pilots", "2"]].concat());
    assert!(text.contains("late: swap of 2 drones; its first tick waits for 2 pilots."), "{text}");
    assert!(text.contains(&format!("crazyflie world join --server {url} --world late")), "{text}");
    for (drone, pilot) in pilots.into_iter().enumerate() {
        let output = pilot.wait_with_output().unwrap();
        let reply: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!((&reply["drone"], &reply["ticks"]), (&json!(drone), &json!(40)), "{reply}");
    }
}
