//! A learner of actors and what an actor may do wrong: hostile frames, doubled, late and
//! foreign answers. None of them changes a policy, and each is counted.

use std::io::{Read, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::mpsc::channel;
use std::thread;
use std::time::Duration;

use lab::actors::actor::{SentSteps, build, serve};
use lab::actors::coordinate::{Coordinator, Watch};
use lab::actors::drive::Episodes;
use lab::actors::envelope::{HEAD_BYTES, Kind, Outgoing, receive};
use lab::actors::message::{Assignment, EpisodeKey, assignment, policy, put_ended, put_hello};
use lab::actors::tally::ActorsTally;
use lab::stop::Stop;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use shm_config::config::from_toml;
use shm_config::message::Step;
use supervisor::machine::signals::pause;
use tempfile::TempDir;

use crate::small_training::{BLOCK, clock, config};

const STEPS: u64 = 4 * BLOCK;

/// What an actor of a test does at its end of a connection.
type Act = Box<dyn FnOnce(UnixStream) + Send>;

/// Trains with these actors; each is a thread at the other end of a connection. Returns the
/// last policy.
fn train(actors: Vec<(&str, Act)>) -> (Vec<u8>, ActorsTally) {
    let place = TempDir::new().expect("a folder");
    let mut coordinator = Coordinator::new(&config(), place.path(), (0, None)).expect("a learner");
    let mut threads = Vec::new();
    for (name, act) in actors {
        let (own, theirs) = UnixStream::pair().expect("a pair of sockets");
        coordinator.join(name, own).expect("joined");
        threads.push(thread::spawn(move || act(theirs)));
    }
    let watch = Watch {
        clock,
        stop: &Stop::default(),
        look: &mut |_, _| Ok(()),
    };
    let trained = coordinator.train((place.path(), STEPS), watch);
    trained.expect("trained");
    let tally = coordinator.finish();
    for thread in threads {
        thread.join().expect("an actor of the test");
    }
    (last_policy(place.path()), tally)
}

/// Trains with an actor that has to end before an honest one begins, so that the learner has
/// met both however fast the honest one is.
fn train_after(hostile: impl FnOnce(UnixStream) + Send + 'static) -> (Vec<u8>, ActorsTally) {
    let (ended, end) = channel::<()>();
    let first = move |line| {
        hostile(line);
        drop(ended);
    };
    let second = move |line| {
        // Nothing is sent: it waits for the drop.
        let _ = end.recv();
        honest(line);
    };
    train(vec![
        ("hostile", Box::new(first)),
        ("honest", Box::new(second)),
    ])
}

fn last_policy(folder: &Path) -> Vec<u8> {
    let file = folder.join(format!("policies/{STEPS:08}.onnx"));
    std::fs::read(file).expect("the last policy")
}

fn honest(mut line: UnixStream) {
    // The learner may close the connection at its end.
    let _ = serve(&mut line, "");
}

fn honest_actor() -> (&'static str, Act) {
    ("honest", Box::new(honest))
}

/// An actor that says what a test wants in place of its answers.
struct Scripted {
    line: UnixStream,
    out: Outgoing,
    body: Vec<u8>,
    episodes: Episodes,
    policy: Vec<u8>,
}

impl Scripted {
    fn new(mut line: UnixStream) -> Scripted {
        let (mut out, mut body) = (Outgoing::default(), Vec::new());
        put_hello(&mut out, &build(), "");
        out.send(Kind::Hello, &mut line).expect("sent");
        receive(&mut line, &[Kind::Welcome], &mut body).expect("welcome");
        let text = std::str::from_utf8(&body).expect("text");
        let config = from_toml(text, "the configuration").expect("a configuration");
        Scripted {
            line,
            out,
            body,
            episodes: Episodes::new(&config).expect("episodes"),
            policy: Vec::new(),
        }
    }

    /// The next assignment; `None` at the end.
    fn asked(&mut self) -> Option<Assignment> {
        loop {
            let kinds = [Kind::Policy, Kind::Drive, Kind::Finish];
            match receive(&mut self.line, &kinds, &mut self.body).ok()? {
                Kind::Policy => self.policy = policy(&self.body).expect("a policy").1.to_vec(),
                Kind::Drive => return Some(assignment(&self.body).expect("an assignment")),
                _ => return None,
            }
        }
    }

    fn drive(&self, asked: &Assignment) -> Vec<Step> {
        let policy = (asked.version > 0).then(|| {
            self.episodes
                .policy(asked.version, &self.policy)
                .expect("a policy")
        });
        let mut steps = Vec::new();
        let watch = |step: &Step| {
            steps.push(*step);
            std::ops::ControlFlow::Continue(())
        };
        let driven = self
            .episodes
            .drive(asked.key, asked.ticks_max, policy, watch);
        driven.expect("driven");
        steps
    }

    fn send(&mut self, key: EpisodeKey, steps: &[Step]) {
        let mut sending = SentSteps::new(key, &mut self.out);
        for step in steps {
            // The learner may have closed the connection.
            let _ = sending.add(step, &mut self.line);
        }
        let _ = sending.end(steps.len() as u32, &mut self.line);
    }
}

#[test]
fn doubled_late_and_slow_answers_change_no_policy() {
    let (expected, _) = train(vec![honest_actor()]);
    let doubled = |line| {
        let mut actor = Scripted::new(line);
        while let Some(asked) = actor.asked() {
            let steps = actor.drive(&asked);
            actor.send(asked.key, &steps);
            actor.send(asked.key, &steps);
        }
    };
    let (policy, tally) = train(vec![("doubled", Box::new(doubled)), honest_actor()]);
    assert!(tally.doubles > 0, "{tally:?}");
    assert_eq!(tally.refused.len(), 0, "{tally:?}");
    assert!(policy == expected, "doubled answers");

    // It answers its first question when another actor has done so already.
    let late = |line| {
        let mut actor = Scripted::new(line);
        let mut is_first = true;
        while let Some(asked) = actor.asked() {
            let steps = actor.drive(&asked);
            if std::mem::take(&mut is_first) {
                pause(Duration::from_millis(2500));
            }
            actor.send(asked.key, &steps);
        }
    };
    let slow = |mut line: UnixStream| {
        pause(Duration::from_millis(200));
        let _ = serve(&mut line, "");
    };
    let (policy, tally) = train(vec![("late", Box::new(late)), ("slow", Box::new(slow))]);
    assert!(tally.given_again > 0, "{tally:?}");
    assert!(policy == expected, "a late answer");
}

/// A frame with its head as it should be.
fn frame(kind: Kind, body: &[u8]) -> Vec<u8> {
    let mut out = Outgoing::default();
    out.begin().extend_from_slice(body);
    out.close(kind).to_vec()
}

#[test]
fn hostile_frames_are_refused_with_their_reason_and_change_nothing() {
    let (expected, _) = train(vec![honest_actor()]);
    let hello = frame(Kind::Hello, format!("{}\n", build()).as_bytes());
    let changed = |at: usize, value: u8| {
        let mut bytes = hello.clone();
        bytes[at] ^= value;
        bytes
    };
    let mut random = Xoshiro256PlusPlus::seed_from_u64(7);
    let mut noise = vec![0; 5000];
    random.fill_bytes(&mut noise);
    let cases = [
        ("no frame", noise),
        ("other version", changed(4, 1)),
        ("other layout", changed(8, 1)),
        (
            "unexpected kind",
            changed(6, Kind::Hello as u8 ^ Kind::Steps as u8),
        ),
        ("too long", changed(19, 0x40)),
        ("wrong checksum", changed(HEAD_BYTES, 1)),
        ("other build", frame(Kind::Hello, b"another one\n")),
        ("", hello[..HEAD_BYTES - 3].to_vec()),
        ("", hello[..HEAD_BYTES + 2].to_vec()),
    ];
    for (reason, bytes) in cases {
        let attack = move |mut line: UnixStream| {
            let _ = line.write_all(&bytes);
            let _ = line.shutdown(Shutdown::Write);
            // Until the learner closes the connection.
            let _ = line.read_to_end(&mut Vec::new());
        };
        let (policy, tally) = train_after(attack);
        let refused: Vec<_> = tally.refused.keys().map(String::as_str).collect();
        let wanted: Vec<_> = [reason]
            .into_iter()
            .filter(|word| !word.is_empty())
            .collect();
        assert_eq!(refused, wanted, "{tally:?}");
        assert_eq!(tally.actors["hostile"].deaths, 1, "{reason}: {tally:?}");
        assert!(policy == expected, "{reason}");
    }
}

/// What an actor that was admitted sends in place of an answer.
type Attack = fn(&mut Scripted, &Assignment, Vec<Step>);

#[test]
fn wrong_answers_are_refused_with_their_reason_and_change_nothing() {
    let (expected, _) = train(vec![honest_actor()]);
    let cases: [(&str, Attack); 7] = [
        ("invalid content", |actor, asked, mut steps| {
            steps[3].expert.steer = f64::NAN;
            actor.send(asked.key, &steps);
        }),
        ("steps out of order", |actor, asked, mut steps| {
            steps.remove(2);
            actor.send(asked.key, &steps);
        }),
        ("steps out of order", |actor, asked, steps| {
            let ticks = steps.len() as u32 + 1;
            let mut sending = SentSteps::new(asked.key, &mut actor.out);
            for step in &steps {
                sending.add(step, &mut actor.line).expect("sent");
            }
            let _ = sending.end(ticks, &mut actor.line);
        }),
        ("steps out of order", |actor, asked, _| {
            put_ended(&mut actor.out, asked.key, 0);
            let _ = actor.out.send(Kind::Ended, &mut actor.line);
        }),
        ("not asked for", |actor, asked, steps| {
            let key = EpisodeKey {
                episode: asked.key.episode + 50,
                ..asked.key
            };
            actor.send(key, &steps);
        }),
        ("not asked for", |actor, asked, steps| {
            let mut more = steps.clone();
            while more.len() as u32 <= asked.ticks_max {
                let mut step = steps[0];
                step.header.tick = more.len() as u64;
                more.push(step);
            }
            actor.send(asked.key, &more);
        }),
        ("not asked for", |actor, asked, steps| {
            let key = EpisodeKey {
                block: asked.key.block + 1,
                ..asked.key
            };
            actor.send(key, &steps);
        }),
    ];
    for (case, (reason, attack)) in cases.into_iter().enumerate() {
        let act = move |line| {
            let mut actor = Scripted::new(line);
            if let Some(asked) = actor.asked() {
                let steps = actor.drive(&asked);
                attack(&mut actor, &asked, steps);
            }
            // Until the learner closes the connection.
            let _ = actor.asked();
        };
        let (policy, tally) = train_after(act);
        assert_eq!(
            tally.refused.get(reason),
            Some(&1),
            "case {case}: {tally:?}"
        );
        assert!(policy == expected, "case {case}: {reason}");
    }
}
