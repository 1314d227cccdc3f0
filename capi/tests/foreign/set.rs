//! Sets of the shipped programs with a world, a planner, a judge and a policy in C++ and
//! in Python. Each test says what is missing where there is no compiler or no Python.

use std::fs;
use std::path::Path;

use crate::languages::{checkout, example_in_cpp, example_in_python, has_compiler, has_python};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use shm_config::message::{Driver, Message, Progress, Reason, Step};
use shm_config::services::{PROGRESS, Process, STEP};
use shm_config::wire::{Subscriber, Wire};
use vlaps_tests::{Set, depends_on_load, programs, until};

/// Drives one episode in lockstep to its end; its JSON.
fn drive(label: &str, programs: &[(&str, &Path)]) -> serde_json::Value {
    let set = Set::new(label);
    let mut words = vec![
        "--lockstep",
        "--episodes",
        "1",
        "--gate",
        "expert",
        "--no-record",
    ];
    for (option, program) in programs {
        words.extend([*option, program.to_str().expect("UTF-8")]);
    }
    let output = set.run(&words);
    assert!(output.status.success(), "{output:?}\n{}", set.logs());
    set.json()
}

#[test]
fn the_examples_have_at_most_80_lines() {
    for folder in ["examples/cpp", "examples/python"] {
        for entry in fs::read_dir(checkout().join(folder))
            .expect(folder)
            .flatten()
            // A folder there is a package with a manifest of its own.
            .filter(|entry| entry.path().is_file())
        {
            let text = fs::read_to_string(entry.path()).expect("a source");
            let lines = text.lines().count();
            assert!(lines < 80, "{} has {lines} lines", entry.path().display());
        }
    }
}

#[test]
fn a_world_and_a_planner_in_two_languages_drive_and_repeat_bit_by_bit() {
    if !has_compiler() || !has_python() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let of = |name: &str| {
        [
            example_in_cpp(folder.path(), name),
            example_in_python(folder.path(), name),
        ]
    };
    let (worlds, planners) = (of("world"), of("planner"));
    for (world, planner) in [(&worlds[1], &planners[0]), (&worlds[0], &planners[1])] {
        let both = [
            ("--world", world.as_path()),
            ("--planner", planner.as_path()),
        ];
        let [first, second] = ["a", "b"].map(|label| drive(label, &both));
        let episode = &first["episodes"][0];
        assert_eq!(episode["outcome"], "arrived", "{first}");
        assert_eq!(episode["strict"], true, "{first}");
        assert_eq!(first["command_digest"], second["command_digest"]);
        assert!(first["command_digest"].is_string(), "{first}");
    }
}

/// Reads the steps and the progress of a set from outside.
struct Watch {
    steps: Subscriber<Step>,
    progress: Subscriber<Progress>,
    _wire: Wire,
}

impl Watch {
    fn new(set: &Set) -> Self {
        until("the set drives", || set.logs().contains("world: ready"));
        let wire = Wire::join(set.name(), Process::Learner).expect("shared memory");
        Self {
            steps: wire.subscriber(STEP).expect("steps"),
            progress: wire.subscriber(PROGRESS).expect("progress"),
            _wire: wire,
        }
    }

    /// Reads steps until one fulfils the condition; each of them must be valid.
    fn until(&mut self, what: &str, wish: impl Fn(&Step) -> bool) {
        until(what, || {
            self.steps.update_connections();
            while let Some(step) = self.steps.receive() {
                assert_eq!(step.check(), Ok(()));
                if wish(&step) {
                    return true;
                }
            }
            false
        });
    }

    fn until_driving(&mut self) {
        let drives = |step: &Step| {
            let is_fresh = step.plan.header.tick == step.observation.header.tick;
            step.driver() == Driver::Expert && is_fresh
        };
        self.until("the expert drives on a plan of the tick", drives);
    }

    fn until_moving(&mut self) {
        until("the car moves", || {
            self.progress.update_connections();
            let newest = self.progress.newest(Message::check);
            newest.is_some_and(|progress| progress.speed_mps > 0.0)
        });
    }

    /// Waits until the world has braked without a command and stands.
    fn until_standing(&mut self) {
        until("the world brakes", || {
            self.progress.update_connections();
            let newest = self.progress.newest(Message::check);
            newest.is_some_and(|progress| progress.braked > 0 && progress.speed_mps == 0.0)
        });
    }
}

/// Ends a stopped program, unless the supervisor has done so already.
fn kill(pid: i32) {
    let _ = kill_process(Pid::from_raw(pid).expect("a pid"), Signal::KILL);
}

/// Sends a signal to the program of a set that `status` names.
fn signal(set: &Set, process: &str, signal: Signal) -> i32 {
    let pid = set.status_of(process)["pid"].as_i64().expect("a pid") as i32;
    kill_process(Pid::from_raw(pid).expect("a pid"), signal).expect("it lives");
    pid
}

fn end(mut set: Set) -> Value {
    set.signal(Signal::INT);
    assert_eq!(set.wait(), Some(0), "{}", set.logs());
    set.json()
}

#[test]
fn in_real_time_the_car_brakes_for_dead_programs_and_drives_on_with_the_next() {
    if !has_compiler() || !has_python() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let planner = example_in_cpp(folder.path(), "planner");
    let world = example_in_python(folder.path(), "world");
    let mut set = Set::new("dead");
    let both = [
        world.to_str().expect("UTF-8"),
        planner.to_str().expect("UTF-8"),
    ];
    let rate = ["--no-realtime", "--gate", "expert", "--no-record"];
    set.start(&[&["--world", both[0], "--planner", both[1]], rate.as_slice()].concat());
    let mut watch = Watch::new(&set);
    watch.until_driving();
    // A stopped planner: the controller brakes; a killed one is replaced.
    let planner = signal(&set, "planner", Signal::STOP);
    let unplanned = |step: &Step| step.reason() == Some(Reason::Unplanned);
    watch.until("the controller brakes without a plan", unplanned);
    kill(planner);
    watch.until_driving();
    // No commands: the world brakes by itself. A car that stands would prove nothing.
    watch.until_moving();
    let controller = signal(&set, "controller", Signal::STOP);
    watch.until_standing();
    kill(controller);
    watch.until_driving();
    // A stopped world: the controller brakes.
    let world = signal(&set, "world", Signal::STOP);
    let blind = |step: &Step| step.reason() == Some(Reason::Blind);
    watch.until("the controller brakes without an observation", blind);
    kill(world);
    watch.until_driving();
    drop(watch);
    let json = end(set);
    assert!(json["restarts"].as_u64() >= Some(3), "{json}");
    for process in ["world", "planner", "controller"] {
        let row = &json["processes"][process];
        let number = |key: &str| row[key].as_f64().expect(key);
        let instants = (number("elapsed_s") / number("period_s")).round();
        assert_eq!(
            instants,
            number("ticks") + number("skipped"),
            "{process}: {row}"
        );
    }
}

/// Drives the corridor with a policy; its JSON.
fn drive_policy(label: &str, words: &[&str]) -> Value {
    let set = Set::new(label);
    let begin = ["--lockstep", "--episodes", "1", "--no-record"];
    let output = set.run(&[begin.as_slice(), words].concat());
    assert!(output.status.success(), "{output:?}\n{}", set.logs());
    set.json()
}

#[test]
fn judges_in_two_languages_let_a_policy_made_in_cpp_drive_where_it_is_safe() {
    if !has_compiler() || !has_python() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("lane.onnx");
    let maker = example_in_cpp(folder.path(), "policy");
    let made = std::process::Command::new(maker).arg(&file).status();
    assert!(made.expect("it starts").success());
    let world = example_in_cpp(folder.path(), "world");
    let text = |path: &Path| path.to_str().expect("UTF-8").to_string();
    let (world, file) = (text(&world), text(&file));
    let with_policy = ["--world", &world, "--policy", &file];
    let alone = drive_policy("alone", &[&with_policy[..], &["--gate", "policy"]].concat());
    assert_eq!(alone["episodes"][0]["outcome"], "arrived", "{alone}");
    assert!(alone["share"]["policy"].as_f64() > Some(0.5), "{alone}");
    for judge in [
        example_in_cpp(folder.path(), "judge"),
        example_in_python(folder.path(), "judge"),
    ] {
        let judge = text(&judge);
        let json = drive_policy("judge", &[&with_policy[..], &["--judge", &judge]].concat());
        assert_eq!(json["episodes"][0]["outcome"], "arrived", "{json}");
        assert!(
            json["reasons"]["policy"]["advised"].as_u64() > Some(50),
            "{json}"
        );
    }
}

/// All promises but that of punctuality, which depends on the load of this machine; with a
/// car whose scanner neither covers the circle nor is in its middle.
#[test]
fn worlds_in_two_languages_keep_the_promises_of_a_world() {
    if !has_compiler() || !has_python() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    for world in [
        example_in_cpp(folder.path(), "world"),
        example_in_python(folder.path(), "world"),
    ] {
        let report = folder.path().join("conform.json");
        let output = std::process::Command::new(programs().join("vlaps-supervisor"))
            .arg("conform")
            .arg(&world)
            .arg("--vehicle")
            .arg(checkout().join("vehicles/car-1-10.toml"))
            .arg("--json")
            .arg(&report)
            .current_dir(folder.path())
            .output()
            .expect("it starts");
        let text = fs::read_to_string(&report);
        let text = text.unwrap_or_else(|error| panic!("{error}: {output:?}"));
        let json: Value = serde_json::from_str(&text).expect("JSON");
        let rows = json["rows"].as_array().expect("rows");
        assert!(rows.len() > 20, "{json}");
        for row in rows {
            assert!(
                depends_on_load(row) || row["held"] == true,
                "{}: {row}",
                world.display()
            );
        }
    }
}
