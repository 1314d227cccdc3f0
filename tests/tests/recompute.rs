//! Steps of real process sets, read from the wire, are recomputed from the run's own
//! configuration file.

#[path = "../../policy/tests/bad/mod.rs"]
#[allow(dead_code)]
mod bad;

use std::fs;

use controller::Recomputer;
use shm_config::config::load;
use shm_config::message::{Driver, Reason, Step};
use shm_config::services::{Process, STEP};
use shm_config::wire::Wire;
use vlaps_tests::{Set, until};

/// Any net passes this canary period, and none is rolled back.
const LENIENT: [&str; 4] = [
    "--set",
    "policy.veto_rate_max=1.0",
    "--set",
    "policy.shadow_ticks=5",
];

/// Runs a set to its end; returns the steps that were read and recomputed.
fn recomputed(set: &mut Set, arguments: &[&str], ticks: u64) -> Vec<Step> {
    set.start(arguments);
    until("the run is up", || set.pids("vlaps-world").len() == 1);
    let wire = Wire::join(set.name(), Process::Learner).expect("shared memory");
    let mut port = wire.subscriber(STEP).expect("steps");
    let config = load(&set.paths().config_file()).expect("the run's configuration");
    let mut steps: Vec<Step> = Vec::new();
    until("enough is driven", || {
        port.update_connections();
        steps.extend(std::iter::from_fn(|| port.receive()));
        steps.last().is_some_and(|step| step.header.tick >= ticks)
    });
    drop((port, wire));
    assert_eq!(set.wait(), Some(0), "{}", set.logs());
    let mut recomputer = Recomputer::new(&config);
    for step in &steps {
        let difference = recomputer.first_difference(step);
        assert_eq!(difference, None, "tick {}", step.header.tick);
    }
    steps
}

#[test]
fn every_step_of_a_lockstep_run_is_recomputed_from_the_wire() {
    let mut set = Set::new("recompute");
    fs::write(set.folder().join("policy.onnx"), bad::good(32, 1)).expect("a file");
    let words = ["--lockstep", "--seed", "3", "--duration", "60"];
    let files = ["--gate", "rules", "--policy", "policy.onnx"];
    let arguments = [&words[..], &files[..], &LENIENT[..]].concat();
    let steps = recomputed(&mut set, &arguments, 550);
    assert!(steps.len() > 100, "{} steps", steps.len());
    assert!(steps.iter().any(|step| step.policy.present == 1));
    assert!(steps.iter().any(|step| step.driver() == Driver::Expert));
}

#[test]
fn every_step_of_a_takeover_in_real_time_is_recomputed_from_the_wire() {
    let mut set = Set::new("takeover");
    fs::write(set.folder().join("policy.onnx"), bad::good(32, 1)).expect("a file");
    let keys = "1.0 space\n1.2 left\n1.6 up\n2.5 space\n";
    fs::write(set.folder().join("keys.txt"), keys).expect("a file");
    let words = ["--seed", "3", "--duration", "4", "--no-realtime"];
    let files = ["--gate", "human", "--keys", "keys.txt"];
    let policy = ["--policy", "policy.onnx"];
    let arguments = [&words[..], &files[..], &policy[..], &LENIENT[..]].concat();
    let steps = recomputed(&mut set, &arguments, 34);
    let taken_over = |step: &&Step| step.reason() == Some(Reason::Takeover);
    assert!(steps.iter().filter(taken_over).count() > 5);
    assert!(steps.iter().any(|step| step.driver() == Driver::Policy));
    assert!(steps.iter().all(|step| step.observation_entry.port_ns > 0 || step.observation_entry.admission == 0));
}
