//! Two machines as far as the kernel can make them of one: two network namespaces with a
//! virtual cable between them, and another monotonic clock on the other side.

#[path = "common/namespaces.rs"]
mod namespaces;
#[path = "common/sets.rs"]
mod sets;

use std::time::Duration;

use namespaces::{Cable, Namespaces, epoch_s, joined_at, permitted, run};
use serde_json::Value;
use sets::{Stage, count, file, is_joined, wait_for};

const POLICY: &str = "results/learning/ppl-10000.onnx";

/// A stage with a clock of its own on the other machine, 5,000 s ahead, where this kernel has
/// such clocks.
fn with_clocks(cable: &Cable) -> Option<Stage> {
    let mut stage = cable.0.stage(0, 1)?;
    let has_clocks = run(&["unshare", "-T", "--monotonic", "5000", "--fork", "true"]);
    match has_clocks {
        Ok(()) => {
            let words = "unshare -T --monotonic 5000 --fork --kill-child=SIGTERM";
            stage.other.extend(words.split(' ').map(String::from));
        }
        Err(why) => println!("skipped: another clock: {why}"),
    }
    Some(stage)
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
    let Some(cable) = permitted(Cable::new()) else {
        return;
    };
    let Some(stage) = with_clocks(&cable) else {
        return;
    };
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

/// Two vehicles and their judges at one bridge. A judge that is sent to the other vehicle, too,
/// never joins it, and neither run hears of the other.
#[test]
fn two_runs_on_one_network_never_hear_each_other() {
    let Some(spaces) = permitted(Namespaces::bridged(4)) else {
        return;
    };
    let [Some(one), Some(two)] = [spaces.stage(0, 2), spaces.stage(1, 3)] else {
        return;
    };
    let stages = [one, two];
    // One port for both: the host alone tells them apart.
    let (_, port) = stages[0]
        .address()
        .rsplit_once(':')
        .map(|(host, port)| (host.to_string(), port.to_string()))
        .expect("a port");
    let policy = file(POLICY);
    let addresses = stages
        .each_ref()
        .map(|stage| format!("{}:{port}", stage.host));
    let bundles =
        [0, 1].map(|at: usize| stages[at].invite("judge", &addresses[at], "judge.bundle"));
    let mut ups = [0, 1].map(|at: usize| {
        let address = addresses[at].as_str();
        stages[at].up(&["--policy", &policy, "--duration", "25", "--judge", address])
    });
    let joins = [0, 1].map(|at: usize| stages[at].join(&bundles[at]));
    let advices = |at: usize| {
        count(
            &stages[at].vehicle_report("judge"),
            "advice",
            "received",
            "messages",
        )
    };
    wait_for("advice in both runs", || advices(0) > 10 && advices(1) > 10);
    // The judge of each run at the port of the other vehicle.
    let strays = [0, 1].map(|at: usize| {
        let (stage, run) = (&stages[at], format!("{}s", stages[at].run()));
        let target = format!("{}@{}", stage.run(), addresses[1 - at]);
        let words = ["join", &target, "--bundle", &bundles[at], "--run", &run];
        stage.start(&stage.other, "vlaps-link", &words)
    });
    for stray in &strays {
        wait_for("no answer", || stray.text().contains("no vehicle answers"));
    }
    for (at, up) in ups.iter_mut().enumerate() {
        assert_eq!(up.wait(), Some(0), "{}", up.text());
        let (summary, report) = (stages[at].summary(), stages[at].vehicle_report("judge"));
        let own: Value =
            serde_json::from_slice(&std::fs::read(&bundles[at]).expect("a bundle")).expect("JSON");
        let peers = report["peers"].as_array().expect("peers");
        assert_eq!(peers.len(), 1, "{report}");
        assert_eq!(peers[0]["peer"], own["peer"]);
        assert_eq!(peers[0]["session"]["sessions"], 1, "{report}");
        assert_eq!(report["refused_total"], 0, "{}", report["refused"]);
        assert!(summary["share"]["policy"].as_f64() > Some(0.0), "{summary}");
        assert_eq!([&summary["skipped"], &summary["restarts"]], [0, 0]);
        print_row(&format!("run {} of two at one bridge", at + 1), &stages[at]);
    }
    for (mut stray, mut join) in strays.into_iter().zip(joins) {
        stray.end();
        join.end();
        assert!(!stray.text().contains(" joined "), "{}", stray.text());
        assert_eq!(
            join.text().matches(" joined ").count(),
            1,
            "{}",
            join.text()
        );
    }
}
