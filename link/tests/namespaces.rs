//! Two machines as far as the kernel can make them of one: two network namespaces with a
//! virtual cable between them, and another monotonic clock on the other side.

#![allow(clippy::disallowed_methods)] // a test measures time

#[path = "common/sets.rs"]
mod sets;

use std::process::Command;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use sets::{Running, Stage, count, file, is_joined, wait_for};

const POLICY: &str = "results/learning/ppl-10000.onnx";

fn run(words: &[&str]) -> Result<(), String> {
    let output = Command::new(words[0]).args(&words[1..]).output();
    let output = output.map_err(|error| format!("{}: {error}", words[0]))?;
    match output.status.success() {
        true => Ok(()),
        false => {
            let text = String::from_utf8_lossy(&output.stderr).trim().to_string();
            Err(format!("{}: {text}", words.join(" ")))
        }
    }
}

/// Two network namespaces with a cable.
struct Cable {
    names: [String; 2],
    ends: [String; 2],
}

impl Cable {
    /// # Errors
    /// What this machine does not permit.
    fn new(number: u32) -> Result<Self, String> {
        let id = std::process::id();
        let cable = Self {
            names: [format!("vl{id}-{number}a"), format!("vl{id}-{number}b")],
            ends: [format!("v{id}{number}a"), format!("v{id}{number}b")],
        };
        let [a, b] = [&*cable.names[0], &*cable.names[1]];
        let [x, y] = [&*cable.ends[0], &*cable.ends[1]];
        for name in [a, b] {
            run(&["ip", "netns", "add", name])?;
            run(&["ip", "-n", name, "link", "set", "lo", "up"])?;
        }
        run(&[
            "ip", "link", "add", x, "netns", a, "type", "veth", "peer", "name", y, "netns", b,
        ])?;
        for (name, end, at) in [(a, x, "10.77.0.1/24"), (b, y, "10.77.0.2/24")] {
            run(&["ip", "-n", name, "addr", "add", at, "dev", end])?;
            run(&["ip", "-n", name, "link", "set", end, "up"])?;
        }
        Ok(cable)
    }

    /// Takes the vehicle's end of the cable away, or puts it back.
    fn set(&self, state: &str) -> Result<(), String> {
        run(&[
            "ip",
            "-n",
            &self.names[0],
            "link",
            "set",
            &self.ends[0],
            state,
        ])
    }

    /// A stage whose vehicle is on one end and whose other machine is on the other, with a
    /// clock 5,000 s ahead where this kernel has clocks of its own.
    fn stage(&self) -> Option<Stage> {
        let mut stage = Stage::new()?;
        let words = |text: &str| text.split(' ').map(String::from).collect::<Vec<_>>();
        stage.vehicle = words(&format!("ip netns exec {}", self.names[0]));
        stage.other = words(&format!("ip netns exec {}", self.names[1]));
        let has_clocks = run(&["unshare", "-T", "--monotonic", "5000", "--fork", "true"]);
        match has_clocks {
            Ok(()) => stage.other.extend(words(
                "unshare -T --monotonic 5000 --fork --kill-child=SIGTERM",
            )),
            Err(why) => println!("skipped: another clock: {why}"),
        }
        stage.host = "10.77.0.1".into();
        Some(stage)
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        for name in &self.names {
            let _ = run(&["ip", "netns", "del", name]);
        }
    }
}

fn cable(number: u32) -> Option<Cable> {
    let made = Cable::new(number);
    made.inspect_err(|why| println!("skipped: networks that fail: {why}"))
        .ok()
}

fn epoch_s() -> f64 {
    let since = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .expect("a date");
    since.as_secs_f64()
}

/// When each session of the other machine began, s since 1970.
fn joined_at(join: &Running) -> Vec<f64> {
    let text = join.text();
    let lines = text
        .lines()
        .filter(|line| line.contains(" joined vehicle="));
    lines
        .filter_map(|line| {
            let stamp = line.split_whitespace().next()?;
            let output = Command::new("date")
                .args(["-d", stamp, "+%s.%N"])
                .output()
                .ok()?;
            String::from_utf8_lossy(&output.stdout).trim().parse().ok()
        })
        .collect()
}

fn print_row(network: &str, stage: &Stage) {
    let summary = stage.summary();
    let lateness = &summary["release_lateness_us"];
    let report = stage.vehicle_report("judge");
    let advice = |key: &str| count(&report, "advice", "received", key);
    println!(
        "{network}: ticks {} skipped {}, release lateness us p50 {} p99 {} max {}, advice {} \
         skipped {} doubled {} reordered {}, policy {}, clock {}",
        summary["ticks"],
        summary["skipped"],
        lateness["p50"],
        lateness["p99"],
        lateness["max"],
        advice("messages"),
        advice("skipped"),
        advice("doubled"),
        advice("reordered"),
        summary["share"]["policy"],
        report["peers"][0]["session"]["clock"],
    );
}

/// A partition: the expert drives, and the judge is back within two seconds of its end.
#[test]
fn a_partition_is_survived_and_ends_within_two_seconds() {
    let Some(cable) = cable(1) else { return };
    let Some(stage) = cable.stage() else { return };
    let policy = file(POLICY);
    let address = stage.address();
    let bundle = stage.invite("judge", &address, "judge.bundle");
    let mut up = stage.up(&["--policy", &policy, "--duration", "60", "--judge", &address]);
    let mut join = stage.join(&bundle);
    let report = || stage.vehicle_report("judge");
    wait_for("advice", || {
        count(&report(), "advice", "received", "messages") > 10
    });
    cable.set("down").expect("a partition");
    wait_for("the session's end", || !is_joined(&report()));
    std::thread::park_timeout(Duration::from_secs(12));
    let sessions = joined_at(&join).len();
    cable.set("up").expect("a network");
    let healed_s = epoch_s();
    wait_for("a new session", || joined_at(&join).len() > sessions);
    let rejoined_s = joined_at(&join)[sessions] - healed_s;
    println!("rejoined {rejoined_s:.3} s after a partition of 12 s");
    let before = count(&report(), "advice", "received", "messages");
    wait_for("advice", || {
        count(&report(), "advice", "received", "messages") > before + 10
    });
    assert_eq!(up.wait(), Some(0), "{}", up.text());
    // `unshare` passes no signal on; it ends its child when it is killed.
    join.kill();
    print_row("partition of 12 s", &stage);
    assert!(rejoined_s < 2.0, "{rejoined_s} s");
    assert_eq!(stage.summary()["restarts"], 0);
}
