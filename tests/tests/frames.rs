//! Pictures on request from a driving set: they show the requested tick and do not
//! affect the drive.

use std::time::Duration;

use rustix::process::Signal;
use serde_json::Value;
use shm_config::Message;
use shm_config::message::{FrameRequest, Header, Observation, Outlook, Proposal, View};
use shm_config::services::{FORESIGHT, FRAME, FRAME_REQUEST, OBSERVATION, Process};
use shm_config::wire::Wire;
use vehicle::Action;
use vlaps_tests::{Set, until};

/// Number of pictures, requested one after the other.
const PICTURES: u64 = 8;
/// Every second request is for an observation that is this many older.
const BEHIND: usize = 15;

/// How requests are made.
struct Requests {
    /// Polls of 2 ms for an answer.
    looks: u32,
    /// Requests in all, answered or not.
    all: u64,
}

/// Each request is answered.
const IN_REAL_TIME: Requests = Requests {
    looks: 2_000,
    all: PICTURES,
};

/// An episode takes a tenth of a second, and the world answers for the running one and the
/// one before: on a busy machine a request may come too late, and is made again.
const IN_LOCKSTEP: Requests = Requests {
    looks: 200,
    all: 5 * PICTURES,
};

fn request(seen: &Header, view: View) -> FrameRequest {
    let proposal = |pedal| Proposal::new(Some(Action { steer: 0.1, pedal }));
    FrameRequest {
        header: *seen,
        proposals: [proposal(-1.0), proposal(1.0)],
        view: view.code(),
        width: 480,
        height: 320,
        ..FrameRequest::default()
    }
}

/// Requests pictures of a running set like a gate; returns what was foreseen at each.
fn ask(set: &Set, by: &Requests) -> Vec<[Outlook; 2]> {
    until("the set drives", || set.paths().supervisor_pid().is_some());
    let wire = Wire::join(set.name(), Process::Gate).expect("the run");
    let mut requests = wire.publisher(FRAME_REQUEST).expect("a port");
    let mut observations = wire.subscriber(OBSERVATION).expect("a port");
    let mut frames = wire.subscriber(FRAME).expect("a port");
    let mut foresights = wire.subscriber(FORESIGHT).expect("a port");
    let mut seen: Vec<Header> = Vec::new();
    let mut requested: Vec<(Header, View)> = Vec::new();
    let mut foreseen = Vec::new();
    while (foreseen.len() as u64) < PICTURES {
        let made = requested.len() as u64;
        assert!(
            made < by.all,
            "{} pictures for {made} requests\n{}",
            foreseen.len(),
            set.logs()
        );
        until("something new is observed", || {
            observations.update_connections();
            let newest: Option<Observation> = observations.newest(Message::check);
            seen.extend(newest.map(|observation| observation.header));
            newest.is_some() && seen.len() > BEHIND
        });
        let (back, view) = match foreseen.len() % 2 {
            0 => (1, View::TopDown),
            _ => (BEHIND, View::Ego),
        };
        let of = seen[seen.len() - back];
        requests.update_connections();
        requests.send(&mut request(&of, view));
        requested.push((of, view));
        let mut is_drawn = false;
        let mut foresight = None;
        for _ in 0..by.looks {
            frames.update_connections();
            foresights.update_connections();
            frames.visit(|frame| {
                assert_eq!(frame.check(), Ok(()));
                assert_eq!((frame.width, frame.height), (480, 320));
                assert!(frame.rgb().iter().any(|&byte| byte != frame.rgb()[0]));
                // An earlier request may be answered after it was given up.
                let asked = |(of, view): &(Header, View)| {
                    is_same(of, &frame.header) && view.code() == frame.camera.view
                };
                assert!(requested.iter().any(asked), "{:?}", frame.header);
                is_drawn |= is_same(&of, &frame.header);
            });
            let newest = foresights.newest(Message::check);
            foresight = newest
                .filter(|newest| is_same(&of, &newest.header))
                .or(foresight);
            if is_drawn && foresight.is_some() {
                break;
            }
            std::thread::park_timeout(Duration::from_millis(2));
        }
        if let Some(foresight) = foresight.filter(|_| is_drawn) {
            assert_eq!(foresight.check(), Ok(()));
            foreseen.push(foresight.outlooks);
        }
    }
    foreseen
}

/// Whether both are of the same instant.
fn is_same(a: &Header, b: &Header) -> bool {
    (a.tick, a.episode, a.taken_ns) == (b.tick, b.episode, b.taken_ns)
}

/// Many times as long as the pictures take.
const LENGTH: [&str; 4] = ["--seed", "3", "--duration", "1500"];

#[test]
fn a_set_in_lockstep_drives_alike_whether_pictures_are_taken_or_not() {
    let drive = |label: &str, watch: fn(&Set)| -> Value {
        let mut set = Set::new(label);
        set.start(&[&["--lockstep"], &LENGTH[..]].concat());
        watch(&set);
        assert_eq!(set.wait(), Some(0), "{}", set.logs());
        set.json()
    };
    let asked = drive("asked", |set| {
        let foreseen = ask(set, &IN_LOCKSTEP);
        let gained = |k: usize| -> f64 { foreseen.iter().map(|pair| pair[k].completion).sum() };
        assert!(
            gained(1) > gained(0),
            "pedal {} over brake {}",
            gained(1),
            gained(0)
        );
    });
    let alone = drive("alone", |_| ());
    assert_eq!(asked["command_digest"], alone["command_digest"]);
    assert_eq!(asked["episodes"], alone["episodes"]);
    assert_eq!(asked["restarts"], 0);
    assert_eq!(asked["skipped"], 0);
}

#[test]
fn a_set_in_real_time_answers_too() {
    let mut set = Set::new("real");
    set.start(&[
        "--seed",
        "3",
        "--duration",
        "60",
        "--set",
        "world.rate_hz=50",
    ]);
    assert_eq!(ask(&set, &IN_REAL_TIME).len() as u64, PICTURES);
    set.signal(Signal::TERM);
    assert_eq!(set.wait(), Some(0), "{}", set.logs());
    assert_eq!(set.json()["restarts"], 0);
}
