//! A process of the same user that the run did not start sends in place of processes
//! that it did start: its messages are refused, counted and reported by name, and never
//! used.

use bench::faults::foreign::{command, forgery_in};
use rustix::process::Signal;
use serde_json::Value;
use shm_config::Instant;
use shm_config::message::{
    Driver, Episode, Health, HealthState, Message, Observation, Progress, Reason, Step,
};
use shm_config::services::{self, COMMAND, EPISODE, OBSERVATION, PROGRESS, Process, STEP};
use shm_config::time::monotonic;
use shm_config::wire::{Publisher, Subscriber, Wire};
use vlaps_tests::{Set, until};

/// The foreign process: it reads the steps of a set, and sends messages.
struct Stranger {
    steps: Subscriber<Step>,
    newest: Step,
    wire: Wire,
}

impl Stranger {
    fn beside(set: &Set) -> Self {
        until("the run is up", || set.pids("vlaps-world").len() == 1);
        let wire = Wire::join(set.name(), Process::Learner).expect("shared memory");
        let mut stranger = Self {
            steps: wire.subscriber(STEP).expect("steps"),
            newest: Step::default(),
            wire,
        };
        let far = |step: &Step| step.driver() == Driver::Expert && step.header.tick > 20;
        stranger.until("the expert drives", || {}, far);
        stranger
    }

    /// Repeats an action until a step fulfils the condition. No step may have used a
    /// message of the foreign process.
    fn until(&mut self, what: &str, mut act: impl FnMut(), wish: impl Fn(&Step) -> bool) {
        let own = std::process::id();
        let (steps, newest) = (&mut self.steps, &mut self.newest);
        until(what, || {
            act();
            steps.update_connections();
            while let Some(step) = steps.receive() {
                assert_eq!(step.check(), Ok(()));
                assert_eq!(forgery_in(&step, own), None);
                *newest = step;
                if wish(&step) {
                    return true;
                }
            }
            false
        });
    }

    fn publisher<M: Message>(&self, service: services::Service<M>) -> Publisher<M> {
        self.wire.publisher(service).expect("a place")
    }
}

/// The output of `status` while an action is repeated.
fn status_beside(set: &Set, mut act: impl FnMut()) -> String {
    let program = vlaps_tests::programs().join("vlaps-supervisor");
    let name = set.name().to_string();
    let mut command = std::process::Command::new(program);
    command.args(["status", "--run", &name]);
    let mut child = command
        .stdout(std::process::Stdio::piped())
        .spawn()
        .expect("it starts");
    until("status has looked", || {
        act();
        child.try_wait().expect("its end").is_some()
    });
    let output = child.wait_with_output().expect("its words");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[allow(clippy::disallowed_methods)] // the stranger's own clock
fn monotonic_ns() -> u64 {
    monotonic().0
}

/// Ends the set in order; returns its summary.
fn end(mut set: Set) -> (Value, String) {
    set.signal(Signal::INT);
    assert_eq!(set.wait(), Some(0), "{}", set.logs());
    (set.json(), set.logs())
}

/// `elapsed / period == ticks + skipped`, for each process that ticks.
fn assert_accounted(json: &Value) {
    for process in ["world", "planner", "controller"] {
        let row = &json["processes"][process];
        let number = |key: &str| row[key].as_f64().expect(key);
        let instants = (number("elapsed_s") / number("period_s")).round();
        let counted = number("ticks") + number("skipped");
        assert_eq!(instants, counted, "{process}: {row}");
    }
    // All processes are on one grid, from about the same instant to about the same
    // instant.
    let ticks = |process: &str| json["processes"][process]["ticks"].as_f64().expect("ticks");
    let apart = (ticks("controller") - ticks("world")).abs();
    assert!(
        apart <= 30.0,
        "a controller that ticks for strangers: {json}"
    );
}

fn refused(json: &Value, process: &str, reason: &str) -> u64 {
    let count = &json["processes"][process]["refusals"][reason];
    count.as_u64().unwrap_or(0)
}

fn foreign_commands(label: &str, ahead: u32) {
    let mut set = Set::new(label);
    set.start(&["--seed", "3"]);
    let mut stranger = Stranger::beside(&set);
    let mut port = stranger.publisher(COMMAND);
    let mut progress = stranger.wire.subscriber(PROGRESS).expect("progress");
    let last = stranger.newest;
    let stands = || {
        let mut forged = command(&last, Instant(monotonic_ns()));
        forged.header.episode += ahead;
        port.update_connections();
        port.send(&mut forged);
        progress.update_connections();
        let said = progress.newest(Message::check);
        said.is_some_and(|said| said.braked > 0 && said.speed_mps < 0.1)
    };
    until("the car stands while it is sent to", stands);
    let shown = status_beside(&set, || {
        let mut forged = command(&last, Instant(monotonic_ns()));
        forged.header.episode += ahead;
        port.send(&mut forged);
    });
    assert!(
        shown.contains("the world brakes: it has no valid command") && shown.contains("foreign "),
        "{shown}"
    );
    let named = format!("process {} (", std::process::id());
    assert!(shown.contains(&named), "{shown}");
    assert!(!shown.contains("namespace"), "a member of the run: {shown}");
    let now = stranger.newest.header.tick;
    // The steps during this time are checked too.
    stranger.until(
        "it drives on when the stranger is silent",
        || {},
        |step| {
            step.driver() == Driver::Expert
                && step.observation.ego.speed_mps > 0.5
                && step.header.tick > now + 10
        },
    );
    drop((port, progress, stranger));
    let (json, logs) = end(set);
    assert!(refused(&json, "world", "foreign") > 0, "{json}");
    assert!(
        json["braked"].as_u64() > Some(0),
        "the summary tells of the brake: {json}"
    );
    let warning = format!("process {} (", std::process::id());
    let named = logs
        .lines()
        .filter(|l| l.contains(&warning) && l.contains("controller"));
    assert_eq!(named.count(), 1, "said once, by name: {logs}");
    assert_accounted(&json);
}

#[test]
fn commands_of_a_stranger_brake_the_car_and_never_drive_it() {
    foreign_commands("fcmd", 0);
}

#[test]
fn commands_of_another_episode_are_counted_and_said() {
    foreign_commands("fepi", 7);
}

#[test]
fn observations_of_a_stranger_consume_no_tick() {
    let mut set = Set::new("fobs");
    set.start(&["--seed", "3"]);
    let mut stranger = Stranger::beside(&set);
    let mut port = stranger.publisher(OBSERVATION);
    let last = stranger.newest.observation;
    let mut sent = 0_u64;
    let forge = || {
        sent += 1;
        let mut forged: Observation = last;
        forged.header.taken_ns = monotonic_ns();
        forged.header.tick += sent;
        // Observations on the grid, off it, too old, in the future, and invalid.
        forged.scheduled_ns = match sent % 4 {
            0 => last.scheduled_ns + 50_000_000 * sent,
            1 => 1,
            2 => u64::MAX / 2,
            _ => monotonic_ns(),
        };
        if sent.is_multiple_of(3) {
            forged.ego.speed_mps = f64::NAN;
        }
        port.update_connections();
        port.send(&mut forged);
    };
    let from = stranger.newest.header.tick;
    stranger.until("it brakes in contest for a while", forge, |step| {
        step.reason() == Some(Reason::Contested) && step.header.tick > from + 30
    });
    stranger.until(
        "it drives again",
        || {},
        |step| step.driver() == Driver::Expert,
    );
    drop((port, stranger));
    let (json, _) = end(set);
    assert!(refused(&json, "controller", "foreign") > 0, "{json}");
    assert!(refused(&json, "planner", "foreign") > 0, "{json}");
    assert_accounted(&json);
    let worst = &json["processes"]["controller"]["release_lateness_us"]["max"];
    assert!(
        worst.as_f64() < Some(5e6),
        "no lateness is measured from a forged instant: {worst}"
    );
}

#[test]
fn forged_healths_and_episodes_end_nothing_and_fill_nothing() {
    let mut set = Set::new("fhealth");
    set.start(&["--seed", "3", "--episodes", "5"]);
    let mut stranger = Stranger::beside(&set);
    let mut healths = stranger.publisher(services::health(Process::World));
    let mut progress = stranger.publisher(PROGRESS);
    let mut episodes = stranger.publisher(EPISODE);
    let header = stranger.newest.header;
    let mut sent = 0_u32;
    let forge = || {
        sent += 1;
        let mut header = header;
        header.taken_ns = monotonic_ns();
        header.episode = match sent.is_multiple_of(2) {
            true => u32::MAX - 1,
            false => sent,
        };
        let mut health = Health {
            header,
            state: HealthState::Finished.code(),
            next_scheduled_ns: u64::from(sent),
            ..Health::default()
        };
        let (mut said, mut episode) = (Progress::default(), Episode::default());
        (said.header, episode.header) = (header, header);
        healths.update_connections();
        progress.update_connections();
        episodes.update_connections();
        healths.send(&mut health);
        progress.send(&mut said);
        episodes.send(&mut episode);
    };
    let from = stranger.newest.header.tick;
    stranger.until("it drives on while healths are forged", forge, |step| {
        step.driver() == Driver::Expert && step.header.tick > from + 20
    });
    set.signal_program("vlaps-world", Signal::KILL);
    let from = stranger.newest.header.tick;
    stranger.until(
        "a world that was killed comes back",
        || {},
        |step| {
            step.driver() == Driver::Expert
                && step.header.tick.abs_diff(from) > 5
                && step.observation.header.taken_ns > 0
        },
    );
    drop((healths, progress, episodes, stranger));
    let (json, _) = end(set);
    let ended = json["episodes"].as_array().expect("episodes").len();
    assert!(ended <= 1, "an episode that no world began: {json}");
    assert_eq!(json["restarts"], 1, "{json}");
    assert_accounted(&json);
}

#[test]
fn a_process_that_is_started_by_hand_does_not_join_a_run() {
    let mut set = Set::new("byhand");
    set.start(&["--seed", "3"]);
    let stranger = Stranger::beside(&set);
    let program = vlaps_tests::programs().join("vlaps-controller");
    let output = std::process::Command::new(program)
        .arg("--config")
        .arg(set.paths().config_file())
        .output()
        .expect("the program starts");
    assert_eq!(output.status.code(), Some(2));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(
        said.contains("is not named as the run's controller"),
        "{said}"
    );
    drop(stranger);
    let (json, _) = end(set);
    assert_accounted(&json);
}
