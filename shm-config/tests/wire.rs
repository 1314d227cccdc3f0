//! The ports on real shared memory.

use std::time::Duration;

use shm_config::message::{
    Advice, Command, Header, Preference, Refusal, RefusalKind, Roster, Step,
};
use shm_config::run::{RunName, RunPaths, name_max};
use shm_config::services::{ADVICE, COMMAND, Process, ROSTER, STEP, STEP_QUEUE, Service};
use shm_config::wire::{Foreigner, PUBLISHERS_MAX, Wire, WireError};
use shm_config::{Instant, Message};

/// A run of this test; its folder is removed with it.
struct TestRun(RunName);

impl TestRun {
    fn new(label: &str) -> Self {
        let name = format!("t{}-{label}", std::process::id());
        Self(name.parse().expect("a valid name"))
    }

    fn join(&self, process: Process) -> Wire {
        Wire::join(&self.0, process).expect("shared memory")
    }

    fn paths(&self) -> RunPaths {
        RunPaths::new(self.0.clone())
    }
}

impl Drop for TestRun {
    fn drop(&mut self) {
        let _ = self.paths().clean_if_dead();
        self.paths().remove_dir();
    }
}

fn command(tick: u64) -> Command {
    Command {
        header: Header {
            tick,
            ..Header::default()
        },
        steer: 0.25,
        pedal: -0.5,
        driver: 0,
        reason: 0,
    }
}

#[test]
fn the_latest_value_wins_and_late_joiners_get_it() {
    let run = TestRun::new("latest");
    let (here, there) = (run.join(Process::Controller), run.join(Process::World));
    let mut publisher = here.publisher(COMMAND).unwrap();
    let mut early = there.subscriber(COMMAND).unwrap();
    for tick in 1..=3 {
        assert!(publisher.send(&mut command(tick)));
    }
    assert_eq!(early.newest(Message::check).map(|c| c.header.tick), Some(3));
    assert_eq!(early.newest(Message::check), None);
    let mut late = there.subscriber(COMMAND).unwrap();
    publisher.update_connections();
    let seen = late.newest(Message::check).expect("history");
    assert_eq!((seen.header.tick, seen.header.sequence), (3, 3));
    assert_eq!(seen.header.producer, std::process::id());
}

type Spoil = fn(&mut Command);

/// Inadmissible messages: each has one fault, and is refused for it.
const SPOILS: [(RefusalKind, Spoil); 5] = [
    (RefusalKind::Content, |c| c.steer = f64::NAN),
    (RefusalKind::Content, |c| c.driver = u32::MAX),
    (RefusalKind::Stale, |c| {
        c.header.taken_ns = NOW.0 - 2 * LIMIT_NS
    }),
    (RefusalKind::Future, |c| {
        c.header.taken_ns = NOW.0 + LIMIT_NS
    }),
    (RefusalKind::Episode, |c| c.header.episode = 7),
];
const NOW: Instant = Instant(10_000_000_000);
const LIMIT_NS: u64 = 250_000_000;

/// The check of a world: content, age, episode.
fn admit(command: &Command) -> Result<(), Refusal> {
    command.admit(NOW, LIMIT_NS)?;
    match command.header.episode {
        0 => Ok(()),
        episode => Err(Refusal::Episode {
            episode,
            expected: 0,
        }),
    }
}

#[test]
fn an_inadmissible_message_never_hides_an_admissible_one() {
    let run = TestRun::new("hides");
    let (one, other) = (run.join(Process::Controller), run.join(Process::Learner));
    let world = run.join(Process::World);
    let mut reader = world.subscriber(COMMAND).unwrap();
    let mut first = one.publisher(COMMAND).unwrap();
    let mut second = other.publisher(COMMAND).unwrap();
    let good = |tick| {
        let mut command = command(tick);
        command.header.taken_ns = NOW.0;
        command
    };
    let mut tick = 0;
    for (kind, spoil) in SPOILS {
        let before = world.refused().counts[kind.code() as usize];
        // Whichever of the two is read first.
        for good_first in [true, false] {
            tick += 1;
            let (mut good, mut bad) = (good(tick), good(1000 + tick));
            spoil(&mut bad);
            match good_first {
                true => (first.send(&mut good), second.send(&mut bad)),
                false => (first.send(&mut bad), second.send(&mut good)),
            };
            reader.update_connections();
            let seen = reader.newest(admit).map(|c| c.header.tick);
            assert_eq!(seen, Some(tick), "{kind}, the good one first: {good_first}");
        }
        let after = world.refused().counts[kind.code() as usize];
        assert_eq!(after - before, 2, "{kind}: each refusal is counted");
    }
    let mut alone = good(1);
    alone.pedal = f64::INFINITY;
    first.send(&mut alone);
    assert_eq!(reader.newest(admit), None, "alone it is refused, too");
}

#[test]
fn a_process_that_the_run_did_not_start_is_not_heard() {
    let run = TestRun::new("foreign");
    let (here, there) = (run.join(Process::Controller), run.join(Process::World));
    let mut publisher = here.publisher(COMMAND).unwrap();
    let mut reader = there.subscriber(COMMAND).unwrap();
    let mut roster = Roster::default();
    // The process id of a living process that is not this one.
    roster.set(Process::Controller, Some(1));
    there.trust(&roster);
    publisher.send(&mut command(1));
    assert_eq!(reader.newest(Message::check), None);
    let foreign = RefusalKind::Foreign.code() as usize;
    assert_eq!((there.contests(), there.refused().counts[foreign]), (1, 1));
    let place = Process::Controller;
    let pid = std::process::id();
    assert_eq!(there.foreigner(), Some(Foreigner { pid, place }));
    // Its own claim does not count: the library reports the sender.
    let mut forged = command(2);
    forged.header.producer = 1;
    publisher.send(&mut forged);
    assert_eq!(reader.newest(Message::check), None);
    roster.set(Process::Controller, Some(pid));
    there.trust(&roster);
    publisher.send(&mut command(3));
    assert_eq!(
        reader.newest(Message::check).map(|c| c.header.tick),
        Some(3)
    );
    assert_eq!(there.contests(), 2, "its own are no contest");
}

#[test]
fn two_memberships_of_one_process_id_are_a_contest() {
    let run = TestRun::new("twins");
    let (one, twin) = (run.join(Process::Controller), run.join(Process::Controller));
    let world = run.join(Process::World);
    let mut reader = world.subscriber(COMMAND).unwrap();
    let mut first = one.publisher(COMMAND).unwrap();
    let mut second = twin.publisher(COMMAND).unwrap();
    let pid = std::process::id();
    let mut roster = Roster::default();
    roster.set(Process::Controller, Some(pid));
    world.trust(&roster);
    let mut contests = Vec::new();
    for (tick, of_twin) in [false, false, true, false].into_iter().enumerate() {
        match of_twin {
            true => second.send(&mut command(tick as u64)),
            false => first.send(&mut command(tick as u64)),
        };
        reader.update_connections();
        assert!(reader.newest(Message::check).is_some());
        contests.push(world.contests());
    }
    assert_eq!(contests, [0, 0, 1, 2]);
    let place = Process::Controller;
    assert_eq!(world.foreigner(), Some(Foreigner { pid, place }));
}

#[test]
fn a_roster_is_taken_from_its_author_alone() {
    let run = TestRun::new("roster");
    let (here, there) = (run.join(Process::Supervisor), run.join(Process::World));
    let mut port = here.publisher(ROSTER).unwrap();
    let mut roster = Roster::default();
    roster.set(Process::Controller, Some(std::process::id()));
    port.send(&mut roster);
    // The roster of another process than the author is ignored.
    there.follow(1).unwrap();
    port.update_connections();
    assert_eq!(there.named(Process::Controller), None);
    there.follow(std::process::id()).unwrap();
    port.update_connections();
    assert_eq!(there.named(Process::Controller), Some(std::process::id()));
}

#[test]
fn places_that_are_held_are_named_as_the_cause() {
    let run = TestRun::new("held");
    let wire = run.join(Process::Controller);
    let held: Vec<_> = (0..PUBLISHERS_MAX)
        .map(|_| wire.publisher(COMMAND).expect("a place"))
        .collect();
    let error = wire.publisher(COMMAND).err().expect("no place is left");
    assert!(
        error.to_string().contains("all places are taken"),
        "{error}"
    );
    drop(held);
    wire.publisher(COMMAND).expect("places again");
}

#[test]
fn a_publisher_that_appears_between_two_reads_is_read_at_the_next_one() {
    let run = TestRun::new("comes");
    let (one, other) = (run.join(Process::Controller), run.join(Process::Learner));
    let world = run.join(Process::World);
    let mut reader = world.subscriber(COMMAND).unwrap();
    let mut first = one.publisher(COMMAND).unwrap();
    reader.update_connections();
    // The connections were updated with one publisher: one read a tick, and the message
    // of the other one is not lost.
    first.send(&mut command(0));
    assert!(reader.newest(Message::check).is_some());
    let mut second = other.publisher(COMMAND).unwrap();
    first.send(&mut command(1));
    second.send(&mut command(2));
    let seen = [reader.newest(Message::check), reader.newest(Message::check)]
        .map(|c| c.map(|c| c.header.tick));
    assert!(
        seen == [Some(1), Some(2)] || seen == [Some(2), Some(1)],
        "{seen:?}"
    );
    reader.update_connections();
    first.send(&mut command(3));
    second.send(&mut command(4));
    assert!(reader.newest(Message::check).is_some());
    assert_eq!(
        reader.newest(Message::check),
        None,
        "with two publishers the read takes both"
    );
    drop(first);
    reader.update_connections();
    second.send(&mut command(5));
    assert_eq!(
        reader.newest(Message::check).map(|c| c.header.tick),
        Some(5)
    );
}

#[test]
fn a_queue_counts_exactly_what_it_lost() {
    let run = TestRun::new("queue");
    let (here, there) = (run.join(Process::Controller), run.join(Process::Learner));
    let mut publisher = here.publisher(STEP).unwrap();
    let mut reader = there.subscriber(STEP).unwrap();
    let mut step = Step::default();
    publisher.send(&mut step);
    assert!(reader.receive().is_some());
    let sent = STEP_QUEUE as u64 + 100;
    for _ in 0..sent {
        assert!(
            publisher.send(&mut step),
            "a full queue never blocks or fails the producer"
        );
    }
    let mut read = 0;
    while reader.receive().is_some() {
        read += 1;
    }
    assert_eq!(reader.lost(), 100);
    assert_eq!(read + reader.lost(), sent);
}

#[test]
fn unread_messages_of_many_dead_publishers_are_read() {
    let run = TestRun::new("gone");
    let (controller, gate) = (run.join(Process::Controller), run.join(Process::Gate));
    let mut steps = gate.subscriber(STEP).expect("a port");
    let gone = 2 * PUBLISHERS_MAX as u64;
    for tick in 0..gone {
        let mut port = controller.publisher(STEP).expect("a port");
        let mut step = Step::default();
        step.header.tick = tick;
        assert!(port.send(&mut step));
        // It is connected while it lives, and read after it has ended.
        steps.update_connections();
        drop(port);
        steps.update_connections();
    }
    let ticks: Vec<u64> = std::iter::from_fn(|| steps.receive())
        .map(|step| step.header.tick)
        .collect();
    assert_eq!(ticks, Vec::from_iter(0..gone));
}

#[test]
fn the_longest_name_of_a_run_has_room_for_a_bell() {
    let mut name = format!("t{}-long", std::process::id());
    name.extend(std::iter::repeat_n('x', name_max() - name.len()));
    assert!(format!("{name}x").parse::<RunName>().is_err());
    let run = TestRun(name.parse().expect("a valid name"));
    let wire = run.join(Process::World);
    for _ in 0..PUBLISHERS_MAX {
        wire.doorbell(Process::World).expect("a bell");
    }
}

#[test]
fn runs_do_not_hear_each_other() {
    let (one, other) = (TestRun::new("one"), TestRun::new("other"));
    let mut publisher = one.join(Process::Gate).publisher(ADVICE).unwrap();
    let mut reader = other.join(Process::Controller).subscriber(ADVICE).unwrap();
    publisher.send(&mut Advice {
        preference: Preference::Policy.code(),
        ..Advice::default()
    });
    assert!(reader.newest(Message::check).is_none());
}

#[test]
fn a_doorbell_wakes_at_once_and_times_out_without() {
    let run = TestRun::new("bell");
    let world = run.join(Process::World);
    let bell = world.doorbell(Process::World).unwrap();
    bell.wait(Duration::from_millis(1));
    let name = run.0.clone();
    let ringer = std::thread::spawn(move || {
        let wire = Wire::join(&name, Process::Controller).expect("shared memory");
        let mut publisher = wire.publisher(COMMAND).unwrap();
        publisher.send(&mut command(1));
    });
    // Longer than the test's limit: only the bell can end this wait.
    bell.wait(Duration::from_secs(3600));
    ringer.join().unwrap();
}

mod another_layout {
    use super::*;
    shm_config::message! {
        /// A command with another layout.
        pub struct Command: 40 bytes {
            /// The header.
            pub header: Header,
            /// One number instead of four.
            pub steer: f64,
        }
    }
    impl Message for Command {
        fn header(&self) -> &Header {
            &self.header
        }
        fn header_mut(&mut self) -> &mut Header {
            &mut self.header
        }
        fn check(&self) -> Result<(), shm_config::message::Refusal> {
            Ok(())
        }
    }
}

#[test]
fn different_layouts_refuse_each_other_by_name() {
    use shm_config::layout::Layout;
    let run = TestRun::new("layout");
    let wire = run.join(Process::World);
    let _ours = wire.subscriber(COMMAND).unwrap();
    let theirs: Service<another_layout::Command> = Service::custom(
        COMMAND.name,
        COMMAND.from,
        COMMAND.row.wakes,
        COMMAND.row.delivery,
    );
    let error = run
        .join(Process::Controller)
        .publisher(theirs)
        .err()
        .expect("refused");
    let WireError::Layout { .. } = error else {
        panic!("wrong error: {error}");
    };
    let text = error.to_string();
    assert!(
        text.contains(&format!("{:016x}", Command::FINGERPRINT)),
        "{text}"
    );
    assert!(
        text.contains(&format!("{:016x}", another_layout::Command::FINGERPRINT)),
        "{text}"
    );
}

#[test]
fn nothing_is_left_of_a_run() {
    let run = TestRun::new("leaves");
    {
        let wire = run.join(Process::World);
        let _publisher = wire.publisher(ADVICE).unwrap();
        assert!(!run.paths().shared_memory().unwrap().is_empty());
        assert!(
            run.paths().clean_if_dead().unwrap().is_none(),
            "a living run is left alone"
        );
    }
    let swept = run.paths().clean_if_dead().unwrap();
    assert!(swept.is_some(), "a dead run is swept");
    assert_eq!(
        run.paths().shared_memory().unwrap(),
        Vec::<std::path::PathBuf>::new()
    );
}

#[test]
fn only_the_user_may_enter() {
    use std::os::unix::fs::PermissionsExt;
    let run = TestRun::new("private");
    let wire = run.join(Process::World);
    let _publisher = wire.publisher(ADVICE).unwrap();
    let mode = |path: &std::path::Path| path.metadata().unwrap().permissions().mode() & 0o077;
    assert_eq!(mode(&run.paths().dir()), 0);
    for file in run.paths().shared_memory().unwrap() {
        assert_eq!(mode(&file), 0, "{}", file.display());
    }
}

#[test]
fn age_is_judged_at_the_door() {
    let command = Command {
        header: Header {
            taken_ns: 1_000_000_000,
            ..Header::default()
        },
        ..command(1)
    };
    let limit_ns = 50_000_000;
    assert!(command.admit(Instant(1_050_000_000), limit_ns).is_ok());
    assert!(command.admit(Instant(1_050_000_001), limit_ns).is_err());
    assert!(command.admit(Instant(999_999_999), limit_ns).is_ok());
    assert!(command.admit(Instant(900_000_000), limit_ns).is_err());
}

#[test]
fn runs_that_end_do_not_keep_others_from_starting() {
    let threads = (0..4).map(|k| {
        std::thread::spawn(move || {
            for round in 0..200 {
                let run = TestRun::new(&format!("race{k}-{round}"));
                run.paths().create().expect("a folder");
            }
        })
    });
    for thread in threads.collect::<Vec<_>>() {
        thread.join().expect("no thread failed");
    }
}

/// How long it takes to open and to close eight reading ends.
#[allow(clippy::disallowed_methods)] // a sleep has a least length, and no greatest
fn eight_ports(wire: &Wire) -> [Duration; 2] {
    let begun = std::time::Instant::now();
    let ports: Vec<_> = (0..8)
        .map(|_| wire.latest(COMMAND).expect("a port"))
        .collect();
    let opened = begun.elapsed();
    drop(ports);
    [opened, begun.elapsed() - opened]
}

/// So that no tick pays for many of its ports; 3 ms after each.
#[test]
fn who_only_reads_opens_and_closes_port_by_port() {
    let run = TestRun::new("beside");
    let least = Duration::from_millis(8 * 3);
    let recorder = run.join(Process::Recorder);
    assert!(eight_ports(&recorder).iter().all(|took| *took >= least));
    let command = run.join(Process::Supervisor);
    command.follow(std::process::id()).expect("a roster");
    assert!(eight_ports(&command).iter().all(|took| *took >= least));
}
