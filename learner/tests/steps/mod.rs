//! Steps as a run publishes them, made without a run.
#![allow(dead_code)]

use learner::replay::INPUTS;
use shm_config::config::{Algorithm, Config, GateMode};
use shm_config::message::{Driver, FEATURES, Judge, Preference, Proposal, Reason, Step};
use vehicle::Action;

/// Time from tick to tick, ns: 10 Hz.
pub const PERIOD_NS: u64 = 100_000_000;
/// The process ids of the publishers, until a test restarts one.
pub const CONTROLLER: u32 = 100;
pub const WORLD: u32 = 200;
/// How long an answer labels steps, ticks: a question each second.
pub const WINDOW: u64 = 10;

/// Steps of a block of [`config`].
pub const BLOCK: u64 = 20;

/// A learner with small nets, blocks and buffers.
pub fn config(algorithm: Algorithm) -> Config {
    let mut config = Config::default();
    // Steps with a veto have a label at once; all other steps have none.
    config.gate.mode = GateMode::Policy;
    let learner = &mut config.learner;
    learner.algorithm = algorithm;
    learner.block_steps = BLOCK as u32;
    learner.updates = 5;
    learner.batch = 16;
    learner.hidden = 16;
    learner.capacity = 64;
    learner.predicted_states = 1;
    learner.imagined_scenes = 1;
    config
}

/// The step of a tick in the first episode; the policy drives. The observations differ
/// from tick to tick.
pub fn step(tick: u64) -> Step {
    let mut step = Step::default();
    step.header.tick = tick;
    step.header.taken_ns = tick * PERIOD_NS;
    step.header.sequence = tick + 1;
    step.header.producer = CONTROLLER;
    let observation = &mut step.observation;
    observation.header = step.header;
    observation.header.producer = WORLD;
    observation.beam_count = 240;
    observation.lidar_max_m = 50.0;
    observation.ranges_m[..240].fill(50.0);
    observation.ranges_m[(tick % 240) as usize] = 5.0 + (tick % 40) as f32;
    observation.ego.speed_mps = 0.1 * (tick % 200) as f64;
    observation.road.left_m = 3.0 + (tick as f64).sin();
    observation.road.right_m = 7.5 - (tick as f64).sin();
    step.observation_age_ns = 0;
    let part = (tick as f64 * 0.7).sin();
    let [expert, policy] =
        [(0.5 * part, 0.3), (-0.5 * part, 0.6)].map(|(steer, pedal)| Action { steer, pedal });
    step.expert = Proposal::new(Some(expert));
    step.policy = Proposal::new(Some(policy));
    step.command.steer = policy.steer;
    step.command.pedal = policy.pedal;
    step.command.driver = Driver::Policy.code();
    step.command.reason = Reason::Advised.code();
    step
}

/// The same step, driven by the expert because the safety check vetoed the policy.
pub fn vetoed(mut step: Step) -> Step {
    step.command.steer = step.expert.steer;
    step.command.pedal = step.expert.pedal;
    step.command.driver = Driver::Expert.code();
    step.command.reason = Reason::Vetoed.code();
    step.policy_assessment.veto = 1;
    step
}

/// The same step with the answer to the question of a tick.
pub fn advised(mut step: Step, (answers, tick): (u64, u64), preference: Preference) -> Step {
    step.advice.header = step.header;
    step.advice.answers = answers;
    step.advice.question_tick = tick;
    step.advice.question_taken_ns = tick * PERIOD_NS;
    step.advice.answered_ns = step.header.taken_ns;
    step.advice.preference = preference.code();
    step.advice.label = preference.code();
    step.advice.label_from_ns = tick * PERIOD_NS;
    step.advice.label_until_ns = (tick + WINDOW) * PERIOD_NS;
    step.advice.judge = Judge::Rules.code();
    step
}

/// The same step in another episode.
pub fn of_episode(mut step: Step, episode: u32) -> Step {
    step.header.episode = episode;
    step.observation.header.episode = episode;
    step
}

/// The policy's input at a step.
pub fn state(step: &Step) -> [f32; INPUTS] {
    let mut state = [0.0; INPUTS];
    state[FEATURES..].copy_from_slice(&step.motion);
    step.observation.features(&mut state).expect("240 beams");
    state
}
