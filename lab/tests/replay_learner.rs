//! The learner's messages and weights, recomputed from a recorded run.

use std::path::Path;

use lab::replay::messages::AnyMessage;
use lab::replay::rehearsal::{Rehearsal, Trouble, config};
use lab::replay::run::{ProcessRow, Replayed, Task, replay};
use lab::replay::source::{InMemory, Offer};
use learner::session::Session;
use policy::Net;
use shm_config::Instant;
use shm_config::config::{Algorithm, Config, GateMode};
use shm_config::message::{Header, Learning, Step};
use shm_config::services::Process;

const TICKS: usize = 400;
const BLOCK: u32 = 40;

fn clock() -> Instant {
    Instant(0)
}

fn small(algorithm: Algorithm, mode: GateMode, seed: u64) -> Config {
    let mut config = config(seed, mode);
    config.learner.enabled = true;
    config.learner.algorithm = algorithm;
    config.learner.block_steps = BLOCK;
    (config.learner.updates, config.learner.batch) = (4, 16);
    (config.learner.hidden, config.learner.label_wait_s) = (16, 2.0);
    (
        config.learner.predicted_states,
        config.learner.imagined_scenes,
    ) = (2, 1);
    config
}

/// A learner beside a run: what it publishes is added to the recording.
struct Beside<'a> {
    config: &'a Config,
    folder: &'a Path,
    session: Session,
    header: Header,
    offers: Vec<Offer>,
    said: Vec<AnyMessage>,
}

impl<'a> Beside<'a> {
    fn start(config: &'a Config, folder: &'a Path, producer: u32) -> Self {
        let session = Session::open(config, folder).expect("a session");
        let header = Header {
            producer,
            ..Header::default()
        };
        let mut own = Self {
            config,
            folder,
            session,
            header,
            offers: Vec::new(),
            said: Vec::new(),
        };
        if own.session.is_due() {
            own.learn();
        } else if own.session.driven() > 0 {
            let file = own.session.policy_file().expect("weights");
            own.offer(file);
        }
        own.say();
        own
    }

    fn learn(&mut self) {
        let block = self.session.learn(|| {}).expect("a block");
        self.offer(block.policy);
    }

    fn offer(&mut self, file: Vec<u8>) {
        self.offers.push(Offer {
            header: self.header,
            sha256: policy::sha256(&file),
            file,
        });
    }

    fn say(&mut self) {
        self.header.sequence += 1;
        self.said.push(AnyMessage::Learning(Learning {
            header: self.header,
            steps: self.session.driven(),
            version: self.offers.len() as u64,
            block_steps: u64::from(self.config.learner.block_steps),
        }));
    }

    fn consider(&mut self, step: &Step) {
        self.session.push(step);
        let Header {
            producer, sequence, ..
        } = self.header;
        self.header = Header {
            producer,
            sequence,
            ..step.header
        };
        if self.session.is_due() {
            self.learn();
        }
        self.say();
    }

    /// Killed, and started again from its files.
    fn restart(self) -> Self {
        let Self {
            config,
            folder,
            session,
            header,
            offers,
            said,
        } = self;
        drop(session);
        let mut again = Self::start(config, folder, header.producer + 1);
        again.offers = [offers, again.offers].concat();
        again.said = [said, again.said].concat();
        again
    }
}

/// A run with a learner that misses the steps `lost` and dies after `dies`.
fn learnt(config: &Config, dies: usize, lost: std::ops::Range<usize>) -> InMemory {
    let seed = config.run.seed;
    let run = Rehearsal::new(config.clone(), seed, Trouble::All).and_then(|run| run.run(TICKS));
    let mut run = run.expect("a rehearsal");
    let folder = tempfile::tempdir().expect("a folder");
    let mut own = Beside::start(config, folder.path(), 600);
    let mut messages = Vec::new();
    let mut steps = 0;
    for message in std::mem::take(&mut run.messages) {
        messages.push(message);
        let AnyMessage::Step(step) = message else {
            continue;
        };
        steps += 1;
        if lost.contains(&steps) {
            continue;
        }
        own.consider(&step);
        if steps == dies {
            own = own.restart();
        }
        messages.append(&mut own.said);
    }
    run.messages = messages;
    run.offers = own.offers;
    run
}

fn of_learner(run: &mut InMemory) -> (Replayed, ProcessRow) {
    run.at = 0;
    let task = Task {
        processes: vec![Process::Learner],
        from: 0,
        tick: None,
    };
    let found = replay(run, &task, clock, |_| {}).expect("a replay");
    let row = found.processes.first().expect("a row").clone();
    (found, row)
}

/// The weights of an offer's first layer.
fn weights(offer: &Offer) -> Vec<f32> {
    match policy::decode(&offer.file).expect("a policy").net {
        Net::Mlp { mlp, .. } => mlp.layers()[0].weights.clone(),
        Net::Graph(_) => panic!("a chain of layers"),
    }
}

#[test]
fn a_learner_that_misses_steps_and_is_killed_is_recomputed_bit_by_bit() {
    let cases = [
        (Algorithm::Pvp, GateMode::Expert),
        (Algorithm::Ppl, GateMode::Expert),
        (Algorithm::HgDagger, GateMode::Expert),
        (Algorithm::Dagger, GateMode::Rules),
    ];
    for (seed, (algorithm, mode)) in cases.into_iter().enumerate() {
        let config = small(algorithm, mode, seed as u64);
        let mut run = learnt(&config, 190, 100..115);
        assert!(run.offers.len() > 6, "{algorithm:?}: {}", run.offers.len());
        let [first, .., last] = &run.offers[..] else {
            panic!("two blocks");
        };
        assert!(weights(first) != weights(last), "{algorithm:?} learns");
        let (found, row) = of_learner(&mut run);
        assert_eq!(found.not_recomputed, Vec::<String>::new(), "{algorithm:?}");
        assert_eq!(found.first_difference, None, "{algorithm:?}");
        assert!(
            row.tally.recomputed > 300 && row.tally.unknown == 0,
            "{row:?}"
        );
    }
}

#[test]
fn a_changed_weight_and_a_changed_input_are_found_and_named() {
    let config = small(Algorithm::Dagger, GateMode::Rules, 3);
    let clean = learnt(&config, 0, 0..0);

    // One beam of the steps from which the learner learnt.
    let mut run = clean.clone();
    for message in &mut run.messages {
        if let AnyMessage::Step(step) = message
            && (20..200).contains(&step.header.tick)
        {
            step.observation.ranges_m[3] *= 0.5;
        }
    }
    let first = of_learner(&mut run).0.first_difference.expect("found");
    assert!(
        first.process == "learner" && first.field.starts_with("weights.layers["),
        "{first:?}"
    );

    // A number of steps.
    let mut run = clean.clone();
    let learning = run.messages.iter_mut().rev().find_map(|m| match m {
        AnyMessage::Learning(learning) => Some(learning),
        _ => None,
    });
    learning.expect("a message").steps ^= 1;
    let first = of_learner(&mut run).0.first_difference.expect("found");
    assert_eq!(first.field, "learning.steps");

    // The weights that were published.
    let mut run = clean.clone();
    let last = run.offers[2].file.len() / 2;
    run.offers[2].file[last] ^= 1;
    let first = of_learner(&mut run).0.first_difference.expect("found");
    assert_eq!(first.field, "weights.sha256");
}

#[test]
fn what_cannot_be_recomputed_is_said() {
    let config = small(Algorithm::Dagger, GateMode::Rules, 4);
    let mut run = learnt(&config, 0, 0..0);
    run.offers.truncate(3);
    let (found, row) = of_learner(&mut run);
    assert_eq!(found.first_difference, None);
    assert!(row.tally.unknown > 100, "{row:?}");
    let why = found.not_recomputed.concat();
    assert!(
        why.contains("weights of") && why.contains("not in the recording"),
        "{why}"
    );
}
