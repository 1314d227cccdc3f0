//! The link over networks that fail: two network namespaces with a virtual cable between
//! them, and `netem` on both of its ends. The other machine has another monotonic clock, too.
//!
//! Prints one row for each network. Correctness, not speed: both machines are this one.

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
        cable.netem("delay 1ms")?;
        Ok(cable)
    }

    /// Sets both ends.
    fn netem(&self, words: &str) -> Result<(), String> {
        for (name, end) in self.names.iter().zip(&self.ends) {
            let mut all = vec![
                "tc", "-n", name, "qdisc", "replace", "dev", end, "root", "netem",
            ];
            all.extend(words.split(' '));
            run(&all)?;
        }
        Ok(())
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

#[test]
fn a_judge_over_networks_that_fail() {
    let Some(cable) = cable(0) else { return };
    let Some(stage) = cable.stage() else { return };
    let policy = file(POLICY);
    let drive = ["--policy", policy.as_str(), "--duration", "20"];
    let mut up = stage.up(&[&drive[..], &["--gate", "rules"]].concat());
    assert_eq!(up.wait(), Some(0), "{}", up.text());
    print_row("the judge beside the car", &stage);
    let address = stage.address();
    let bundle = stage.invite("judge", &address, "judge.bundle");
    for network in [
        "delay 1ms",
        "delay 1ms loss 10%",
        "delay 100ms 20ms",
        "delay 20ms 10ms reorder 25% 50% duplicate 5%",
    ] {
        cable.netem(network).expect("a network");
        let mut up = stage.up(&[&drive[..], &["--judge", &address]].concat());
        let mut join = stage.join(&bundle);
        let advices = || {
            count(
                &stage.vehicle_report("judge"),
                "advice",
                "received",
                "messages",
            )
        };
        wait_for("advice", || advices() > 10);
        assert_eq!(up.wait(), Some(0), "{}", up.text());
        join.end();
        print_row(network, &stage);
        let summary = stage.summary();
        assert_eq!(summary["restarts"], 0, "{network}");
        assert!(summary["share"]["policy"].as_f64() > Some(0.0), "{network}");
        let report = stage.vehicle_report("judge");
        let refused = report["refused_total"].as_u64().expect("a count");
        assert_eq!(refused, 0, "{network}: {}", report["refused"]);
    }
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
    cable.netem("loss 100%").expect("a partition");
    wait_for("the session's end", || !is_joined(&report()));
    std::thread::park_timeout(Duration::from_secs(12));
    let sessions = joined_at(&join).len();
    cable.netem("delay 1ms").expect("a network");
    let healed_s = epoch_s();
    wait_for("a new session", || joined_at(&join).len() > sessions);
    let rejoined_s = joined_at(&join)[sessions] - healed_s;
    println!("rejoined {rejoined_s:.3} s after a partition of 12 s");
    let before = count(&report(), "advice", "received", "messages");
    wait_for("advice", || {
        count(&report(), "advice", "received", "messages") > before + 10
    });
    assert_eq!(up.wait(), Some(0), "{}", up.text());
    join.end();
    print_row("partition of 12 s", &stage);
    assert!(rejoined_s < 2.0, "{rejoined_s} s");
    assert_eq!(stage.summary()["restarts"], 0);
}

/// A learner over a network that loses a tenth: each step arrives, once and in order.
#[test]
fn a_learner_loses_no_step_to_loss_and_partition() {
    let Some(cable) = cable(2) else { return };
    let Some(stage) = cable.stage() else { return };
    let address = stage.address();
    let bundle = stage.invite("learner", &address, "learner.bundle");
    cable.netem("delay 10ms 5ms loss 5%").expect("a network");
    let mut up = stage.up(&[
        "--gate",
        "policy",
        "--duration",
        "45",
        "--learner",
        &address,
        "--set",
        "learner.algorithm=dagger",
        "--set",
        "learner.block_steps=50",
        "--set",
        "learner.updates=20",
    ]);
    let mut join = stage.join(&bundle);
    let report = || stage.vehicle_report("learner");
    wait_for("a policy", || {
        count(&report(), "weights", "received", "messages") > 0
    });
    cable.netem("loss 100%").expect("a partition");
    std::thread::park_timeout(Duration::from_secs(6));
    cable.netem("delay 10ms 5ms loss 5%").expect("a network");
    let run = stage.other_run();
    let received = |key: &str| count(&stage.report(&run, "join"), "step", "received", key);
    let steps = || count(&report(), "step", "sent", "messages");
    wait_for("a time after it", || steps() > 380);
    wait_for("the steps of the partition", || {
        received("messages") + 20 > steps()
    });
    println!(
        "steps sent {}, received {}, lost {}, doubled {}, reordered {}, policies {}",
        steps(),
        received("messages"),
        received("lost"),
        received("doubled"),
        received("reordered"),
        count(&report(), "weights", "received", "messages"),
    );
    assert_eq!(received("lost"), 0);
    assert_eq!(count(&report(), "step", "sent", "lost"), 0);
    assert_eq!(up.wait(), Some(0), "{}", up.text());
    join.end();
    let summary = stage.summary();
    assert!(
        summary["weights"]
            .as_array()
            .is_some_and(|rows| !rows.is_empty()),
        "{summary}"
    );
    assert_eq!(summary["restarts"], 0);
}
