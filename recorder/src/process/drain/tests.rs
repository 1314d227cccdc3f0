use std::collections::BTreeMap;

use shm_config::message::{Observation, Plan, Step};
use shm_config::run::{RunName, RunPaths};
use shm_config::services::{OBSERVATION, PLAN, RECORDED_DEPTH};

use super::*;
use crate::process::ring::{self, RingOut};

/// A run of this test alone, removed at its end.
struct Joined {
    name: RunName,
    wire: Option<Wire>,
}

impl Joined {
    fn new(label: &str) -> Self {
        let name: RunName = format!("r{}{label}", std::process::id())
            .parse()
            .expect("a name");
        let wire = Wire::join(&name, Process::Recorder).expect("shared memory");
        Self {
            name,
            wire: Some(wire),
        }
    }

    fn wire(&self) -> &Wire {
        self.wire.as_ref().expect("joined")
    }
}

impl Drop for Joined {
    fn drop(&mut self) {
        self.wire = None;
        let paths = RunPaths::new(self.name.clone());
        let _ = paths.clean_if_dead();
        paths.remove_dir();
    }
}

fn drain(wire: &Wire, ring_bytes: usize, options: DrainOptions) -> (Drain, RingOut) {
    let (into, out) = ring::ring(ring_bytes);
    let writer = std::thread::current();
    let drain = Drain::open(wire, (into, writer), options).expect("shared memory");
    (drain, out)
}

const REAL_TIME: DrainOptions = DrainOptions {
    when_full: WhenFull::Drop,
    is_lockstep: false,
    from_start: true,
};

/// What came out, by service: the sequence numbers.
fn out(ring: &mut RingOut, drain: &Drain) -> BTreeMap<String, Vec<u64>> {
    let (mut cdr, mut all) = (Vec::new(), BTreeMap::<_, Vec<_>>::new());
    while let Some(label) = ring.pop(&mut cdr) {
        let service = drain.sources[label.channel].service.clone();
        all.entry(service).or_default().push(label.stamp.sequence);
    }
    all
}

#[test]
fn every_message_is_read_beside_a_reader_of_the_newest_and_losses_are_counted() {
    let joined = Joined::new("every");
    let wire = joined.wire();
    let (mut drain, mut ring) = drain(wire, 4 << 20, REAL_TIME);
    let mut newest = wire.subscriber(OBSERVATION).expect("shared memory");
    let mut publisher = wire.publisher(OBSERVATION).expect("shared memory");
    let depth = RECORDED_DEPTH as u64;
    for tick in 1..=depth {
        let mut observation = Observation::default();
        observation.header.tick = tick;
        assert!(publisher.send(&mut observation));
    }
    assert!(drain.turn(Instant(1), &mut || true));
    let expected: Vec<_> = (1..=depth).collect();
    assert_eq!(out(&mut ring, &drain)["observation"], expected);
    assert_eq!(drain.losses().total(), 0);
    newest.update_connections();
    let seen = newest.newest(|_| Ok(())).expect("an observation");
    assert_eq!(seen.header.tick, depth);
    assert!(
        newest.newest(|_| Ok(())).is_none(),
        "one message, the newest"
    );
    // Ten more than the queue holds.
    for _ in 0..depth + 10 {
        assert!(publisher.send(&mut Observation::default()));
    }
    drain.turn(Instant(2), &mut || true);
    let expected: Vec<_> = (depth + 11..=2 * depth + 10).collect();
    assert_eq!(out(&mut ring, &drain)["observation"], expected);
    let text = drain.losses().to_string();
    assert_eq!(text, "observation: queue 10, memory 0, disk 0");
}

fn source(first: FirstNumber) -> impl FnMut(u32, u64) -> u64 {
    let mut source = Source {
        service: "weights".into(),
        first,
        producers: Vec::new(),
    };
    move |producer, sequence| {
        source.lost(&Header {
            producer,
            sequence,
            ..Header::default()
        })
    }
}

#[test]
fn producers_by_turns_lose_nothing_and_each_one_s_gaps_are_counted() {
    let (learner, swap) = (7, 100);
    let mut lost = source(FirstNumber::FromOne);
    for number in 1..=50 {
        assert_eq!(lost(learner, number), 0);
    }
    assert_eq!(lost(swap, 1), 0);
    assert_eq!(lost(learner, 51), 0);
    assert_eq!(lost(learner, 54), 2);
    assert_eq!(lost(swap + 1, 3), 2, "a new producer counts from 1");
    // So many others that the learner is forgotten.
    for other in 0..PRODUCERS_MAX as u32 {
        lost(200 + other, 1);
    }
    assert_eq!(lost(learner, 90), 0, "it is not known how far it was");
    assert_eq!(lost(learner, 92), 1);
}

#[test]
fn a_late_reader_counts_from_the_first_message_that_it_reads() {
    let mut lost = source(FirstNumber::NotOfFirst);
    assert_eq!((lost(7, 51), lost(7, 53), lost(8, 3)), (0, 1, 2));
    // A number that no publisher reaches.
    assert_eq!((lost(9, u64::MAX), lost(9, u64::MAX)), (u64::MAX - 1, 0));
    assert_eq!(lost(9, 1), 0);
    let mut lost = source(FirstNumber::Unknown);
    assert_eq!((lost(7, 1), lost(8, 51), lost(8, 53)), (0, 0, 1));
}

#[test]
fn a_disk_that_hangs_costs_counted_messages_and_no_wait() {
    let joined = Joined::new("hangs");
    let wire = joined.wire();
    // Room for ten steps, and nothing takes them out.
    let (mut drain, mut ring) = drain(wire, 10 * (size_of::<Step>() + 36), REAL_TIME);
    let mut publisher = wire.publisher(STEP).expect("shared memory");
    for _ in 0..30 {
        assert!(publisher.send(&mut Step::default()));
    }
    drain.turn(Instant(1), &mut || true);
    let expected: Vec<_> = (1..=10).collect();
    assert_eq!(out(&mut ring, &drain)["step"], expected);
    assert_eq!(
        drain.losses().to_string(),
        "step: queue 0, memory 20, disk 0"
    );
}

/// In lockstep; a process that waits says so, or the supervisor takes it for dead.
#[test]
fn in_lockstep_a_full_ring_is_waited_for_as_long_as_allowed() {
    let joined = Joined::new("waits");
    let wire = joined.wire();
    let options = DrainOptions {
        when_full: WhenFull::Wait,
        is_lockstep: true,
        ..REAL_TIME
    };
    let (mut drain, mut ring) = drain(wire, 10 * (size_of::<Step>() + 36), options);
    let mut publisher = wire.publisher(STEP).expect("shared memory");
    let mut publish = || {
        for _ in 0..30 {
            assert!(publisher.send(&mut Step::default()));
        }
    };
    publish();
    let (mut cdr, mut waits) = (Vec::new(), 0);
    drain.turn(Instant(1), &mut || {
        waits += 1;
        assert!(ring.pop(&mut cdr).is_some());
        true
    });
    assert_eq!((waits, drain.losses().total()), (20, 0));
    publish();
    let (mut waits, limit) = (0, 3);
    drain.turn(Instant(2), &mut || {
        waits += 1;
        waits < limit
    });
    let text = drain.losses().to_string();
    assert_eq!(text, "step: queue 0, memory 30, disk 0");
}

#[test]
fn a_message_without_a_time_has_that_at_which_it_was_read() {
    let joined = Joined::new("untimed");
    let wire = joined.wire();
    let (mut drain, mut ring) = drain(wire, 4 << 20, REAL_TIME);
    let mut publisher = wire.publisher(STEP).expect("shared memory");
    assert!(publisher.send(&mut Step::default()));
    drain.turn(Instant(5), &mut || true);
    let label = ring.pop(&mut Vec::new()).expect("a step");
    assert_eq!((label.stamp.recorded_ns, label.stamp.taken_ns), (5, 0));
}

#[test]
fn a_turn_is_in_order_of_time_and_of_the_tick() {
    let joined = Joined::new("order");
    let wire = joined.wire();
    let options = DrainOptions {
        is_lockstep: true,
        ..REAL_TIME
    };
    let (mut drain, mut ring) = drain(wire, 4 << 20, options);
    let mut steps = wire.publisher(STEP).expect("shared memory");
    let mut plans = wire.publisher(PLAN).expect("shared memory");
    let mut observations = wire.publisher(OBSERVATION).expect("shared memory");
    for tick in [1, 2] {
        let mut step = Step::default();
        (step.header.tick, step.header.taken_ns) = (tick, 100 * tick);
        let (mut plan, mut observation) = (Plan::default(), Observation::default());
        plan.header = step.header;
        observation.header = step.header;
        assert!(steps.send(&mut step) && plans.send(&mut plan));
        assert!(observations.send(&mut observation));
    }
    drain.turn(Instant(1), &mut || true);
    let (mut cdr, mut order) = (Vec::new(), Vec::new());
    while let Some(label) = ring.pop(&mut cdr) {
        order.push((
            label.stamp.recorded_ns,
            drain.sources[label.channel].service.clone(),
        ));
    }
    let expected = [100, 200]
        .map(|ns| ["observation", "plan", "step"].map(|service| (ns, service.to_string())));
    assert_eq!(order, expected.concat());
    assert_eq!((drain.step_tick, drain.steps), (2, 2));
}
