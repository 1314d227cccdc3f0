//! The link over a network that fails, between real process sets: one row for each network.
//! The proxy of `common/proxy.rs` is that network, so these tests need no privilege.

#![allow(clippy::disallowed_methods)] // a test measures time

#[path = "common/proxy.rs"]
mod proxy;
#[path = "common/sets.rs"]
mod sets;

use std::time::{Duration, Instant};

use proxy::Proxy;
use sets::{Running, Stage, count, file, is_joined, wait_for};

const POLICY: &str = "results/learning/ppl-10000.onnx";

/// A vehicle, its proxy, and a bundle.
struct Rig {
    stage: Stage,
    proxy: Proxy,
    address: String,
    bundle: String,
    role: &'static str,
}

impl Rig {
    fn new(role: &'static str) -> Option<Self> {
        let stage = Stage::new()?;
        let address = stage.address();
        let bundle = stage.invite(role, &address, "peer.bundle");
        Some(Self {
            proxy: Proxy::new(&address),
            stage,
            address,
            bundle,
            role,
        })
    }

    fn join(&self) -> Running {
        let target = format!("{}@{}", self.stage.run(), self.proxy.address);
        let run = self.stage.other_run();
        let words = ["join", &target, "--bundle", &self.bundle, "--run", &run];
        self.stage.start(&self.stage.other, "vlaps-link", &words)
    }

    /// A vehicle that drives for 45 s while a learner elsewhere makes a policy of each block.
    fn learn(&self) -> Running {
        let options = [
            "learner.algorithm=dagger",
            "learner.block_steps=50",
            "learner.updates=20",
        ];
        let drive = ["--gate", "policy", "--duration", "45", "--learner"];
        let settings = options.into_iter().flat_map(|option| ["--set", option]);
        let words = drive.into_iter().chain([self.address.as_str()]);
        self.stage.up(&words.chain(settings).collect::<Vec<_>>())
    }

    fn advices(&self) -> u64 {
        count(
            &self.stage.vehicle_report(self.role),
            "advice",
            "received",
            "messages",
        )
    }

    fn print(&self, network: &str) {
        let summary = self.stage.summary();
        let lateness = &summary["release_lateness_us"];
        let report = self.stage.vehicle_report("judge");
        let clock = &report["peers"][0]["session"]["clock"];
        let advice = |key: &str| count(&report, "advice", "received", key);
        println!(
            "| {network} | {} | {} | {} | {} | {} | {} | {} | {:.2} | {} | {} |",
            summary["ticks"],
            summary["skipped"],
            lateness["p99"],
            lateness["max"],
            advice("messages"),
            advice("skipped"),
            advice("reordered") + advice("doubled"),
            summary["share"]["policy"].as_f64().unwrap_or(f64::NAN),
            clock["round_trip_ms"],
            report["refused_total"],
        );
    }
}

#[test]
fn a_judge_over_networks_that_fail() {
    let Some(rig) = Rig::new("judge") else { return };
    let stage = &rig.stage;
    let policy = file(POLICY);
    let drive = ["--policy", policy.as_str(), "--duration", "20"];
    println!(
        "| network | ticks | skipped | lateness p99, us | max, us | advice | skipped | again or \
         late | policy drove | round trip, ms | refused |"
    );
    let mut up = stage.up(&[&drive[..], &["--gate", "rules"]].concat());
    assert_eq!(up.wait(), Some(0), "{}", up.text());
    rig.print("none: judge beside the car");
    for (network, set) in [
        ("loopback", [0, 0, 0]),
        ("10 % come 250 ms late, as after a loss", [1, 0, 10]),
        ("100 ms each way, 20 ms jitter", [100, 20, 0]),
        ("100 ms each way, 40 ms jitter, 10 % late", [100, 40, 10]),
    ] {
        rig.proxy.set(set);
        let mut up = stage.up(&[&drive[..], &["--judge", &rig.address]].concat());
        let mut join = rig.join();
        wait_for("advice", || rig.advices() > 10);
        assert_eq!(up.wait(), Some(0), "{}", up.text());
        join.end();
        rig.print(network);
        let summary = stage.summary();
        assert_eq!(summary["restarts"], 0, "{network}");
        assert_eq!(summary["skipped"], 0, "{network}");
        assert!(
            summary["share"]["policy"].as_f64() > Some(0.0),
            "{network}: {}",
            join.text()
        );
        let report = stage.vehicle_report("judge");
        assert_eq!(
            report["refused_total"], 0,
            "{network}: {}",
            report["refused"]
        );
    }
}

/// Half open for a minute, then reset: each time the expert drives, and the judge is back
/// within two seconds.
#[test]
fn a_cut_cable_ends_within_two_seconds_and_a_reset_ends_no_session() {
    let Some(rig) = Rig::new("judge") else { return };
    let stage = &rig.stage;
    let policy = file(POLICY);
    let mut up = stage.up(&[
        "--policy",
        &policy,
        "--duration",
        "100",
        "--judge",
        &rig.address,
        "--set",
        "gate.period_s=1",
        "--set",
        "gate.hold_s=2",
    ]);
    let join = rig.join();
    wait_for("advice", || rig.advices() > 10);
    let sessions = || join.text().matches(" joined ").count();
    let before = sessions();
    rig.proxy.cut(true);
    wait_for("the session's end", || {
        !is_joined(&stage.vehicle_report("judge"))
    });
    std::thread::park_timeout(Duration::from_secs(60));
    let healed = Instant::now();
    rig.proxy.cut(false);
    wait_for("a new session", || sessions() > before);
    let rejoined_s = healed.elapsed().as_secs_f64();
    let advices = rig.advices();
    wait_for("advice", || rig.advices() > advices + 5);
    // Zenoh connects again by itself; the session outlives the connection.
    let advices = rig.advices();
    let before = sessions();
    let reset = Instant::now();
    rig.proxy.reset();
    wait_for("advice after the reset", || rig.advices() > advices + 10);
    let advised_s = reset.elapsed().as_secs_f64();
    assert_eq!(sessions(), before, "{}", join.text());
    println!(
        "rejoined {rejoined_s:.3} s after the cut; the eleventh advice {advised_s:.3} s after \
         the reset"
    );
    assert_eq!(up.wait(), Some(0), "{}", up.text());
    let mut join = join;
    join.end();
    rig.print("half open for 60 s, then reset");
    assert!(rejoined_s < 2.0, "{rejoined_s}");
    let summary = stage.summary();
    assert!(
        summary["reasons"]["expert"]["expired"].as_u64() > Some(0),
        "{}",
        summary["reasons"]
    );
    assert_eq!(summary["restarts"], 0);
}

/// A learner over a network that loses, and a cut: each step arrives, once and in order.
#[test]
fn a_learner_loses_no_step_to_loss_and_a_cut() {
    let Some(rig) = Rig::new("learner") else {
        return;
    };
    let stage = &rig.stage;
    rig.proxy.set([10, 5, 5]);
    let mut up = rig.learn();
    let mut join = rig.join();
    let report = || stage.vehicle_report("learner");
    let policies = || count(&report(), "weights", "received", "messages");
    wait_for("a policy", || policies() > 0);
    rig.proxy.cut(true);
    std::thread::park_timeout(Duration::from_secs(6));
    rig.proxy.cut(false);
    let run = stage.other_run();
    let received = |key: &str| count(&stage.report(&run, "join"), "step", "received", key);
    let before = policies();
    wait_for("a policy after it", || policies() > before);
    wait_for("the steps of the cut", || {
        received("messages") + 20 > count(&report(), "step", "sent", "messages")
    });
    assert_eq!(up.wait(), Some(0), "{}", up.text());
    println!(
        "steps sent {}, sent again {}, received {}, lost {}, doubled {}, reordered {}, policies {}",
        count(&report(), "step", "sent", "messages"),
        count(&report(), "step", "sent", "again"),
        received("messages"),
        received("lost"),
        received("doubled"),
        received("reordered"),
        policies(),
    );
    join.end();
    assert_eq!(
        (received("lost"), count(&report(), "step", "sent", "lost")),
        (0, 0)
    );
    // The learner counts a step as lost when its number does not follow the last one.
    let log = stage.path(&format!("runs/{run}/logs/learner.log"));
    let log = std::fs::read_to_string(log).expect("a log");
    let ends = log.lines().find(|line| line.contains(" ends steps="));
    let ends = ends.unwrap_or_else(|| panic!("the learner has not ended: {log}"));
    assert!(ends.contains(" lost=0"), "{ends}");
    let summary = stage.summary();
    assert!(
        summary["weights"]
            .as_array()
            .is_some_and(|rows| !rows.is_empty())
    );
    assert_eq!(summary["restarts"], 0);
}

/// Policy files of half a megabyte over 2 Mbit/s: they take two seconds, and the session and
/// the steps go on beside them.
#[test]
fn policies_arrive_over_a_slow_network() {
    let Some(rig) = Rig::new("learner") else {
        return;
    };
    let stage = &rig.stage;
    rig.proxy.slow(250_000);
    let mut up = rig.learn();
    let mut join = rig.join();
    wait_for("a policy", || {
        count(
            &stage.vehicle_report("learner"),
            "weights",
            "received",
            "messages",
        ) > 0
    });
    let threads = join.threads();
    assert!(
        threads.iter().any(|name| name.starts_with("tx-")),
        "{threads:?}"
    );
    // Reading beside writing, Zenoh's TLS is not safe.
    assert!(
        !threads.iter().any(|name| name.starts_with("rx-")),
        "{threads:?}"
    );
    assert_eq!(up.wait(), Some(0), "{}", up.text());
    join.end();
    let report = stage.vehicle_report("learner");
    let policies = count(&report, "weights", "received", "messages");
    let sessions = &report["peers"][0]["session"]["sessions"];
    let sent = &stage.report(&stage.other_run(), "join")["rows"]["weights"]["sent"];
    println!("policies {policies} over 2 Mbit/s, sessions {sessions}, their sender {sent}");
    assert!(policies >= 3, "{report}");
    assert_eq!(*sessions, 1, "{}", join.text());
    assert_eq!(count(&report, "step", "sent", "lost"), 0);
}

/// Two thousand frames of noise on the vehicle's socket, and connections that say nothing:
/// nothing joins, nothing is adopted, and the judge that is there goes on.
#[test]
fn two_thousand_hostile_frames_on_the_socket_change_nothing() {
    use std::io::Write as _;
    let Some(rig) = Rig::new("judge") else { return };
    let stage = &rig.stage;
    let mut up = stage.up(&["--duration", "30", "--judge", &rig.address]);
    let mut join = stage.join(&rig.bundle);
    wait_for("advice", || rig.advices() > 10);
    let before = rig.advices();
    let mut silent = Vec::new();
    let mut frames = 0;
    for number in 0..200_u32 {
        let Ok(mut stream) = std::net::TcpStream::connect(&rig.address) else {
            continue;
        };
        for frame in 0..10_u32 {
            // TLS records, Zenoh's own frames and plain noise, by turns.
            let kind = [0x16, 0x17, 0x00, 0xff][(frame % 4) as usize];
            let mut bytes = vec![kind, 3, 1, (number % 256) as u8, (frame * 25) as u8];
            bytes.extend((0..200).map(|place| (place * number + frame) as u8));
            frames += u32::from(stream.write_all(&bytes).is_ok());
        }
        if number % 10 == 0 {
            silent.push(stream);
        }
    }
    let advices = rig.advices();
    wait_for("advice beside the noise", || rig.advices() > advices + 20);
    drop(silent);
    assert_eq!(up.wait(), Some(0), "{}", up.text());
    join.end();
    rig.print("noise on the socket");
    let sessions = &stage.vehicle_report("judge")["peers"][0]["session"]["sessions"];
    println!("{frames} frames were taken, advice before {before}, sessions {sessions}");
    assert!(frames >= 1_900, "{frames}");
    assert_eq!(*sessions, 1);
    let report = stage.vehicle_report("judge");
    assert_eq!(
        report["peers"].as_array().map(Vec::len),
        Some(1),
        "{report}"
    );
    assert_eq!(stage.summary()["restarts"], 0);
}
