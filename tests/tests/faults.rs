//! Processes of a driving set are killed and stopped; the car always stays safe.

use rustix::process::Signal;
use serde_json::Value;
use shm_config::message::{Driver, Fault, FaultKind, Message, Reason, Step};
use shm_config::run::RunPaths;
use shm_config::services::{FAULT, Process, STEP};
use shm_config::wire::{Publisher, Subscriber, Wire};
use vlaps_tests::{Set, until};

/// The default age limit of commands.
const COMMAND_AGE_MS: f64 = 250.0;

/// Reads the steps of a set from outside.
struct Watch {
    steps: Subscriber<Step>,
    _wire: Wire,
}

impl Watch {
    fn new(set: &Set) -> Self {
        until("the run is up", || set.pids("vlaps-world").len() == 1);
        let wire = Wire::join(set.name(), Process::Learner).expect("shared memory");
        Self {
            steps: wire.subscriber(STEP).expect("steps"),
            _wire: wire,
        }
    }

    /// Reads steps until one fulfils the condition; each of them must be valid.
    fn until(&mut self, what: &str, wish: impl Fn(&Step) -> bool) -> Step {
        let mut found = None;
        until(what, || {
            self.steps.update_connections();
            while let Some(step) = self.steps.receive() {
                assert_eq!(step.check(), Ok(()));
                if wish(&step) {
                    found = Some(step);
                    return true;
                }
            }
            false
        });
        found.expect("found")
    }

    /// Reads steps until the expert has driven for some of them.
    fn until_driving(&mut self) -> u64 {
        let from = self
            .until("the expert drives", drives_on_fresh_plans)
            .header
            .tick;
        let driving = |step: &Step| drives_on_fresh_plans(step) && step.header.tick > from + 10;
        self.until("the expert drives on", driving).header.tick
    }
}

fn drives_on_fresh_plans(step: &Step) -> bool {
    step.driver() == Driver::Expert && step.plan.header.tick == step.observation.header.tick
}

fn assert_safe(json: &Value) {
    let oldest = json["command_age_max_ms"].as_f64().expect("oldest");
    assert!(oldest > 0.0 && oldest <= COMMAND_AGE_MS, "{json}");
    let number = |key: &str| json[key].as_f64().expect(key);
    let instants = (number("elapsed_s") / number("period_s")).round();
    assert_eq!(instants, number("ticks") + number("skipped"), "{json}");
}

#[test]
fn planner_gate_and_controller_are_killed_in_turn_and_the_episode_goes_on() {
    let mut set = Set::new("kill");
    set.start(&["--seed", "3"]);
    let mut watch = Watch::new(&set);
    watch.until_driving();
    for program in ["vlaps-planner", "vlaps-gate", "vlaps-controller"] {
        let before = set.pids(program);
        assert_eq!(set.signal_program(program, Signal::KILL), 1, "{program}");
        until("it is back", || {
            let now = set.pids(program);
            now.len() == 1 && now != before
        });
        let step = watch.until(program, drives_on_fresh_plans);
        assert_eq!(step.header.episode, 0, "the same episode goes on");
        watch.until_driving();
    }
    drop(watch);
    set.signal(Signal::INT);
    assert_eq!(set.wait(), Some(0), "{}", set.logs());
    let json = set.json();
    assert_safe(&json);
    for process in ["planner", "gate", "controller"] {
        assert_eq!(json["processes"][process]["restarts"], 1, "{json}");
    }
    assert_eq!(json["restarts"], 3);
    assert_eq!(json["episodes"].as_array().map(Vec::len), Some(1), "{json}");
    assert_eq!(json["episodes"][0]["outcome"], "stopped");
}

#[test]
fn a_dead_planner_means_the_brake_until_it_is_back() {
    let mut set = Set::new("brake");
    // The pause before the restart is longer than the age limit of plans.
    set.start(&["--seed", "3", "--set", "supervisor.backoff_ms=1500"]);
    let mut watch = Watch::new(&set);
    watch.until_driving();
    set.signal_program("vlaps-planner", Signal::KILL);
    let braked = |step: &Step| step.driver() == Driver::Brake;
    let step = watch.until("the brake", braked);
    assert_eq!(step.reason(), Some(Reason::Unplanned));
    assert_eq!(step.command.pedal, -1.0);
    watch.until_driving();
    drop(watch);
    set.signal(Signal::TERM);
    assert_eq!(set.wait(), Some(0));
    assert_safe(&set.json());
}

#[test]
fn a_dead_controller_means_that_the_world_brakes() {
    let mut set = Set::new("latch");
    set.start(&["--seed", "3", "--set", "supervisor.backoff_ms=1500"]);
    let mut watch = Watch::new(&set);
    watch.until_driving();
    set.signal_program("vlaps-controller", Signal::KILL);
    watch.until_driving();
    drop(watch);
    set.signal(Signal::HUP);
    assert_eq!(set.wait(), Some(0));
    let json = set.json();
    assert_safe(&json);
    // 1.5 s without commands minus the age limit: at least ten ticks at 10 Hz.
    assert!(json["braked"].as_u64() >= Some(10), "{json}");
}

#[test]
fn a_stopped_planner_is_killed_and_replaced() {
    let mut set = Set::new("hang");
    set.start(&["--seed", "3", "--set", "supervisor.silence_s=0.5"]);
    let mut watch = Watch::new(&set);
    watch.until_driving();
    let before = set.pids("vlaps-planner");
    set.signal_program("vlaps-planner", Signal::STOP);
    until("it is replaced", || {
        let now = set.pids("vlaps-planner");
        now.len() == 1 && now != before
    });
    watch.until_driving();
    drop(watch);
    set.signal(Signal::INT);
    assert_eq!(set.wait(), Some(0));
    assert_safe(&set.json());
}

#[test]
fn a_dead_world_comes_back_and_drives_the_episode_again() {
    let mut set = Set::new("world");
    set.start(&["--seed", "3"]);
    let mut watch = Watch::new(&set);
    watch.until_driving();
    set.signal_program("vlaps-world", Signal::KILL);
    watch.until("the new world's ticks", |step| {
        step.observation.header.tick < 5 && drives_on_fresh_plans(step)
    });
    watch.until_driving();
    drop(watch);
    set.signal(Signal::INT);
    assert_eq!(set.wait(), Some(0));
    let json = set.json();
    assert_eq!(json["processes"]["world"]["restarts"], 1, "{json}");
    assert_eq!(json["episodes"][0]["seed"], 3);
}

#[test]
fn when_the_supervisor_is_killed_everything_stops_and_the_next_start_is_clean() {
    let mut set = Set::new("orphan");
    set.start(&["--seed", "3"]);
    let mut watch = Watch::new(&set);
    watch.until_driving();
    drop(watch);
    set.signal(Signal::KILL);
    set.wait();
    until("no process is left", || set.pids("").is_empty());
    assert!(
        !set.paths().shared_memory().expect("/dev/shm").is_empty(),
        "killed processes leave traces"
    );
    let output = set.run(&["--lockstep", "--seed", "3", "--duration", "5"]);
    assert!(output.status.success(), "{output:?}\n{}", set.logs());
    assert_eq!(set.json()["ticks"], 50);
    assert!(
        set.paths().shared_memory().expect("/dev/shm").is_empty(),
        "nothing is left"
    );
}

#[test]
fn an_orderly_stop_brakes_the_car_to_a_stand() {
    let mut set = Set::new("stop");
    set.start(&["--seed", "3"]);
    let mut watch = Watch::new(&set);
    watch.until_driving();
    watch.until("some speed", |step| step.observation.ego.speed_mps > 2.0);
    set.signal(Signal::INT);
    let stopping = |step: &Step| step.reason() == Some(Reason::Stopping);
    watch.until("the brake", stopping);
    watch.until("a stand", |step| {
        stopping(step) && step.observation.ego.speed_mps < 0.05
    });
    drop(watch);
    assert_eq!(set.wait(), Some(0));
    assert_eq!(set.json()["episodes"][0]["outcome"], "stopped");
    assert!(
        set.paths().shared_memory().expect("/dev/shm").is_empty(),
        "nothing is left"
    );
    assert!(!RunPaths::new(set.name().clone()).dir().exists());
}

#[test]
fn two_sets_drive_side_by_side() {
    let (mut one, mut other) = (Set::new("one"), Set::new("other"));
    one.start(&["--seed", "3"]);
    other.start(&["--seed", "4"]);
    let (mut watch_one, mut watch_other) = (Watch::new(&one), Watch::new(&other));
    watch_one.until_driving();
    watch_other.until_driving();
    one.signal(Signal::KILL);
    one.wait();
    let from = watch_other.until_driving();
    assert!(watch_other.until_driving() > from, "the other drives on");
    drop((watch_one, watch_other));
    other.signal(Signal::TERM);
    assert_eq!(other.wait(), Some(0));
}

/// Orders a set's planner to panic, once. The returned port holds the order until it is
/// read.
fn order_a_panic(set: &Set) -> (Publisher<Fault>, Wire) {
    let wire = Wire::join(set.name(), Process::Learner).expect("shared memory");
    let mut orders = wire.publisher(FAULT).expect("orders");
    let mut order = Fault {
        target: Process::Planner.code(),
        kind: FaultKind::Panic.code(),
        ..Fault::default()
    };
    #[allow(clippy::disallowed_methods)] // the sender of the order reads the clock
    {
        order.header.taken_ns = shm_config::time::monotonic().0;
    }
    assert!(orders.send(&mut order));
    (orders, wire)
}

#[test]
fn orders_to_fail_are_obeyed_where_the_configuration_says_so_alone() {
    for (label, faults) in [("deaf", "run.faults=false"), ("obeys", "run.faults=true")] {
        let mut set = Set::new(label);
        set.start(&["--seed", "3", "--set", faults]);
        let mut watch = Watch::new(&set);
        watch.until_driving();
        let before = set.pids("vlaps-planner");
        let order = order_a_panic(&set);
        if faults.ends_with("true") {
            until("it is replaced", || {
                let now = set.pids("vlaps-planner");
                now.len() == 1 && now != before
            });
        }
        watch.until_driving();
        drop((watch, order));
        set.signal(Signal::INT);
        assert_eq!(set.wait(), Some(0), "{}", set.logs());
        let restarts = &set.json()["processes"]["planner"]["restarts"];
        assert_eq!(*restarts, u64::from(faults.ends_with("true")), "{faults}");
    }
}

#[test]
fn when_the_files_of_a_run_are_removed_it_brakes_and_says_so() {
    let mut set = Set::new("files");
    set.start(&["--seed", "3"]);
    let mut watch = Watch::new(&set);
    watch.until_driving();
    for path in set.paths().shared_memory().expect("/dev/shm") {
        std::fs::remove_file(path).expect("removed");
    }
    // The processes have all they need in memory, and are asked to stop.
    watch.until("the brake", |step| step.reason() == Some(Reason::Stopping));
    drop(watch);
    assert_eq!(set.wait(), Some(1), "{}", set.logs());
    let ended = set.json()["ended"].to_string();
    assert!(ended.contains("files were removed"), "{ended}");
}

#[test]
fn a_supervisor_that_can_open_no_more_files_brakes_and_names_that() {
    use rustix::process::{Resource, Rlimit, prlimit};
    let mut set = Set::new("nofile");
    set.start(&["--seed", "3"]);
    let mut watch = Watch::new(&set);
    watch.until_driving();
    let pid = set.paths().supervisor_pid().expect("a supervisor") as i32;
    let none = Rlimit {
        current: Some(3),
        maximum: Some(3),
    };
    prlimit(rustix::process::Pid::from_raw(pid), Resource::Nofile, none).expect("its limit");
    watch.until("the brake", |step| step.reason() == Some(Reason::Stopping));
    drop(watch);
    assert_eq!(set.wait(), Some(1), "{}", set.logs());
    let said = set.logs();
    assert!(said.contains("Too many open files"), "{said}");
    assert!(!said.contains("files were removed"), "{said}");
}
