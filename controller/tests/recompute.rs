//! A recorded tick, computed again from its step and the configuration alone.

use std::collections::BTreeSet;

use controller::Recomputer;
use shm_config::config::{Config, GateMode, Late};
use shm_config::draw::Draw;
use shm_config::message::Step;

use crate::recorded::{Recording, net, seen};

/// Recordings, each with a configuration and a seed of its own.
const RECORDINGS: u64 = 20;
/// Ticks of each: 100,000 together.
const TICKS: usize = 5_000;

const MODES: [GateMode; 5] = [
    GateMode::Human,
    GateMode::Vlm,
    GateMode::Policy,
    GateMode::Expert,
    GateMode::Takeover,
];
const LATE: [Late; 3] = [Late::Count, Late::Skip, Late::Brake];

fn config(seed: u64) -> Config {
    let mut config = Config::default();
    config.gate.mode = MODES[seed as usize % MODES.len()];
    config.deadlines.controller = LATE[seed as usize % LATE.len()];
    // Random nets are not good drivers; they may drive all the same.
    (config.policy.shadow_ticks, config.policy.watch_ticks) = (20, 40);
    (config.policy.veto_rate_max, config.policy.jump_max) = (0.9, 2.0);
    config
}

/// Every step, in random order: nothing goes from one tick to the next but by the step.
fn shuffle(steps: &mut [Step], seed: u64) {
    let mut draw = Draw::new(seed);
    for k in (1..steps.len()).rev() {
        steps.swap(k, draw.below(k as u64 + 1) as usize);
    }
}

#[test]
fn a_hundred_thousand_ticks_are_recomputed_bit_by_bit_in_any_order() {
    let mut words = BTreeSet::new();
    for seed in 0..RECORDINGS {
        let config = config(seed);
        let mut recording = Recording::new(config.clone(), seed);
        let mut steps: Vec<Step> = (0..TICKS).map(|_| recording.step()).collect();
        shuffle(&mut steps, seed);
        let mut recomputer = Recomputer::new(&config);
        for step in &steps {
            let difference = recomputer.first_difference(step);
            assert_eq!(difference, None, "seed {seed}, tick {}", step.header.tick);
            seen(step, &mut words);
        }
    }
    let expected = "easing; intent contested; intent drive; intent stop; lateness 0; lateness 1; \
         lateness 2; lateness 3; observation absent; observation admitted; observation refused; \
         plan absent; plan admitted; plan refused; advice absent; advice admitted; \
         advice refused; takeover absent; takeover admitted; takeover refused; \
         reason advised; reason blind; reason blocked; reason configured; reason contested; \
         reason expired; reason faulty; reason late; reason shadow; reason stopping; \
         reason takeover; reason unadvised; reason unloaded; reason unplanned; reason vetoed; restart; shadow proposal; stage active; stage shadow; stage unloaded; \
         takeover used; tracking";
    for word in expected.split("; ").chain(["reason unsafe"]) {
        assert!(words.contains(word), "no tick with {word}: {words:?}");
    }
}

#[test]
fn a_policy_that_is_given_is_asked_again() {
    let config = config(2);
    let mut recording = Recording::new(config.clone(), 5).without_policy_faults();
    let steps: Vec<Step> = (0..TICKS).map(|_| recording.step()).collect();
    let (mut active, mut shadow, mut other) = (0, 0, 0);
    for step in steps.iter().filter(|step| step.policy.present == 1) {
        let version = step.weights_version;
        let mut own = Recomputer::with_policy(&config, Box::new(net(version)));
        assert_eq!(own.first_difference(step), None, "version {version}");
        active += 1;
        let another = Box::new(net(version + 1_000));
        let difference = Recomputer::with_policy(&config, another).first_difference(step);
        other += u32::from(difference.is_some_and(|found| found.field.starts_with("policy.")));
    }
    for step in steps.iter().filter(|step| step.shadow.weights_version > 0) {
        let version = step.shadow.weights_version;
        let mut own = Recomputer::with_policy(&config, Box::new(net(version)));
        assert_eq!(own.first_difference(step), None, "shadow version {version}");
        shadow += 1;
    }
    assert!(
        active > 1_000 && shadow > 300 && other > 1_000,
        "{active} active, {shadow} in shadow mode, {other} by another policy"
    );
}

#[test]
fn each_part_of_the_state_before_decides_some_tick() {
    type Forget = fn(&mut Step);
    let parts: [(&str, Forget); 5] = [
        ("pd", |step| step.before.pd = Default::default()),
        ("transfer", |step| step.before.transfer = Default::default()),
        ("refused", |step| step.before.refused += 1),
        ("stage", |step| step.stage = (step.stage + 1) % 3),
        ("intent", |step| step.intent = (step.intent + 1) % 3),
    ];
    let config = config(1);
    let mut recording = Recording::new(config.clone(), 7);
    let steps: Vec<Step> = (0..2_000).map(|_| recording.step()).collect();
    let mut recomputer = Recomputer::new(&config);
    for (part, forget) in parts {
        let decides = |step: &&Step| {
            let mut without = **step;
            forget(&mut without);
            let again = recomputer.recompute(&without);
            again.command != step.command || again.refused != step.refused
        };
        let count = steps.iter().filter(decides).count();
        assert!(count > 0, "no tick depends on {part}");
    }
}
