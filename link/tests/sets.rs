//! Real process sets on the loopback: a judge and a learner that join from outside, ends of
//! both sides, and those who may not join.

#[path = "common/sets.rs"]
mod sets;

use serde_json::Value;
use sets::{Stage, count, file, is_joined, wait_for};

const POLICY: &str = "results/learning/ppl-10000.onnx";

/// The policy drives by the advice of a judge that joins; when it is killed the expert
/// drives, and when it comes again the policy does.
#[test]
fn the_car_drives_by_the_advice_of_a_judge_elsewhere() {
    let Some(stage) = Stage::new() else { return };
    let address = stage.address();
    let bundle = stage.invite("judge", &address, "judge.bundle");
    let policy = file(POLICY);
    let mut up = stage.up(&[
        "--judge",
        &address,
        "--policy",
        &policy,
        "--duration",
        "40",
        "--set",
        "gate.period_s=1",
        "--set",
        "gate.hold_s=2",
    ]);
    let mut join = stage.join(&bundle);
    let advices = || {
        count(
            &stage.vehicle_report("judge"),
            "advice",
            "received",
            "messages",
        )
    };
    wait_for("advice from the other machine", || advices() > 30);
    // The judge's machine dies.
    join.kill();
    wait_for("the session's end", || {
        !is_joined(&stage.vehicle_report("judge"))
    });
    // The advice in force expires.
    std::thread::park_timeout(std::time::Duration::from_secs(3));
    let before = advices();
    let mut join = stage.join(&bundle);
    wait_for("advice again", || advices() > 20 && advices() != before);
    assert_eq!(up.wait(), Some(0), "{}", up.text());
    assert!(matches!(join.end(), Some(0)), "{}", join.text());
    let summary = stage.summary();
    accounted(&summary);
    let policy_share = summary["share"]["policy"].as_f64().expect("a share");
    assert!(policy_share > 0.2, "{}", summary["reasons"]);
    let expert = &summary["reasons"]["expert"];
    assert!(expert["expired"].as_u64() > Some(0), "{expert}");
    assert_eq!(summary["restarts"], 0);
}

/// Drives in lockstep with the process beside the car, then elsewhere: the commands are the
/// same. Both summaries, and the vehicle's report of the second drive.
fn here_and_elsewhere(
    stage: &Stage,
    role: &str,
    drive: &[&str],
    own: &[&str],
) -> (Value, Value, Value) {
    let mut here = stage.up(&[drive, own].concat());
    assert_eq!(here.wait(), Some(0), "{}", here.text());
    let beside = stage.summary();
    let address = stage.address();
    let bundle = stage.invite(role, &address, &format!("{role}.bundle"));
    let mut join = stage.join(&bundle);
    let option = format!("--{role}");
    let far = [
        option.as_str(),
        &address,
        "--set",
        "limits.lockstep_wait_s=30",
    ];
    let mut up = stage.up(&[drive, &far].concat());
    assert_eq!(up.wait(), Some(0), "{}", up.text());
    let report = stage.vehicle_report(role);
    join.end();
    let far = stage.summary();
    assert_eq!(
        far["command_digest"],
        beside["command_digest"],
        "{}",
        join.text()
    );
    println!(
        "{role} that joined: {} steps, {} s, digest {}; beside the car: {} steps, digest {}",
        far["ticks"],
        far["elapsed_s"],
        far["command_digest"],
        beside["ticks"],
        beside["command_digest"]
    );
    (beside, far, report)
}

/// A second run with the same name and settings: a judge that stays begins anew, and keeps
/// its session while its program ends.
#[test]
fn a_judge_that_stays_begins_anew_with_the_next_run() {
    let Some(stage) = Stage::new() else { return };
    let address = stage.address();
    let bundle = stage.invite("judge", &address, "judge.bundle");
    let mut join = stage.join(&bundle);
    for run in 1..=2 {
        let mut up = stage.up(&["--judge", &address, "--duration", "15"]);
        assert_eq!(up.wait(), Some(0), "{}", up.text());
        let report = stage.vehicle_report("judge");
        let advices = count(&report, "advice", "received", "messages");
        assert!(advices > 20, "run {run}: {}", join.text());
        let sessions = &report["peers"][0]["session"]["sessions"];
        assert_eq!(*sessions, 1, "run {run}: {}", join.text());
        assert_eq!(report["refused_total"], 0, "run {run}: {report}");
    }
    join.end();
    let text = join.text();
    assert_eq!(text.matches("begins anew").count(), 1, "{text}");
}

/// In lockstep the same seed gives the same commands with the judge here and elsewhere.
#[test]
fn a_judge_elsewhere_judges_bit_by_bit_as_one_beside() {
    let Some(stage) = Stage::new() else { return };
    let policy = file(POLICY);
    let drive = ["--lockstep", "--episodes", "1", "--policy", &policy];
    let (beside, far, _) = here_and_elsewhere(&stage, "judge", &drive, &["--gate", "rules"]);
    assert_eq!(far["reasons"], beside["reasons"]);
    assert!(
        far["share"]["policy"].as_f64() > Some(0.1),
        "{}",
        far["reasons"]
    );
}

/// A learner elsewhere learns from the same steps and makes the same policy as one beside,
/// bit by bit, and its policies are adopted.
#[test]
fn a_learner_elsewhere_makes_the_same_policies_as_one_beside() {
    let Some(stage) = Stage::new() else { return };
    let drive = [
        "--lockstep",
        "--episodes",
        "1",
        "--gate",
        "policy",
        "--set",
        "learner.block_steps=100",
        "--set",
        "learner.updates=20",
        "--set",
        "learner.algorithm=dagger",
    ];
    let own = ["--set", "learner.enabled=true"];
    let (beside, far, report) = here_and_elsewhere(&stage, "learner", &drive, &own);
    assert_eq!(
        far["weights"].as_array().map(Vec::len),
        beside["weights"].as_array().map(Vec::len)
    );
    assert!(
        far["weights"]
            .as_array()
            .is_some_and(|rows| rows.len() >= 2),
        "{}",
        far["weights"]
    );
    assert!(
        count(&report, "weights", "received", "messages") > 2,
        "{report}"
    );
    assert_eq!(count(&report, "step", "sent", "lost"), 0);
    assert_eq!(report["refused_total"], 0, "{report}");
}

/// Each is refused, counted under its reason, and the car drives on.
#[test]
fn those_who_may_not_join_are_refused_and_counted() {
    let Some(stage) = Stage::new() else { return };
    let address = stage.address();
    let good = stage.invite("judge", &address, "judge.bundle");
    let learner = stage.invite("learner", &address, "learner.bundle");
    let forged = stage.path("forged.bundle");
    let text = std::fs::read_to_string(&learner).expect("a bundle");
    let text = text.replace("\"role\": \"learner\"", "\"role\": \"judge\"");
    write_private(&forged, &text);
    let mut up = stage.up(&["--judge", &address, "--duration", "25"]);
    let reason = |word: &str| stage.vehicle_report("judge")["refused"][word].as_u64() > Some(0);
    {
        let join = stage.join(&learner);
        wait_for("a wrong role", || reason("wrong_role"));
        wait_for("told", || join.text().contains("another role"));
    }
    {
        let _join = stage.join(&forged.display().to_string());
        wait_for("a wrong key", || reason("wrong_key"));
    }
    {
        let words = ["link", "revoke", "--run", &stage.run(), &peer_of(&good)];
        assert!(stage.output("vlaps-link", &words).status.success());
        std::thread::park_timeout(std::time::Duration::from_secs(3));
        let _join = stage.join(&good);
        wait_for("a revoked invitation", || reason("revoked"));
    }
    assert!(!is_joined(&stage.vehicle_report("judge")));
    assert_eq!(up.wait(), Some(0), "{}", up.text());
    let summary = stage.summary();
    accounted(&summary);
    assert_eq!(summary["restarts"], 0);
    let status = stage.output("vlaps-link", &["link", "status", &stage.run()]);
    let status = String::from_utf8_lossy(&status.stdout).into_owned();
    for word in ["wrong_role", "wrong_key", "revoked"] {
        assert!(status.contains(&format!("refused {word}")), "{status}");
    }
}

/// A view reads what leaves the machine, and nothing of it is the command's.
#[test]
fn a_view_elsewhere_sees_steps_and_health() {
    let Some(stage) = Stage::new() else { return };
    let address = stage.address();
    let bundle = stage.invite("view", &address, "view.bundle");
    let mut up = stage.up(&["--duration", "25"]);
    wait_for("the set", || {
        stage.path(&format!("runs/{}/logs", stage.run())).exists()
    });
    let mut serve = None;
    wait_for("a server", || {
        let mut running = stage.start(
            &stage.vehicle,
            "vlaps-link",
            &["link", "serve", &stage.run(), "--listen", &address],
        );
        std::thread::park_timeout(std::time::Duration::from_millis(700));
        let lives = running
            .child
            .as_mut()
            .is_some_and(|child| matches!(child.try_wait(), Ok(None)));
        serve = lives.then_some(running);
        lives
    });
    let mut join = stage.join(&bundle);
    let other = stage.other_run();
    let seen = |row: &str| count(&stage.report(&other, "join"), row, "received", "messages");
    wait_for("steps", || seen("step") > 20);
    wait_for("health", || seen("health/world") > 5);
    let status = stage.output("vlaps-supervisor", &["status", "--run", &other]);
    let status = String::from_utf8_lossy(&status.stdout).into_owned();
    assert!(status.contains("world"), "{status}");
    assert_eq!(seen("weights"), 0);
    join.end();
    assert_eq!(up.wait(), Some(0), "{}", up.text());
    drop(serve);
    accounted(&stage.summary());
}

/// Every tick that was due was driven or is counted as skipped.
fn accounted(summary: &Value) {
    let number = |key: &str| summary[key].as_f64().expect(key);
    let due = number("elapsed_s") / number("period_s");
    assert_eq!(due.round(), number("ticks") + number("skipped"));
}

fn peer_of(bundle: &str) -> String {
    let text = std::fs::read_to_string(bundle).expect("a bundle");
    let bundle: Value = serde_json::from_str(&text).expect("JSON");
    bundle["peer"].as_str().expect("a peer").into()
}

fn write_private(path: &std::path::Path, text: &str) {
    use std::os::unix::fs::PermissionsExt as _;
    std::fs::write(path, text).expect("written");
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600)).expect("a mode");
}
