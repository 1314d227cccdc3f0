//! A recorded run, recomputed and driven on.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use lab::fork::course::{Course, Until};
use lab::fork::drive::{Drive, Wheel};
use lab::fork::start::start;
use lab::fork::unchanged::Unchanged;
use lab::replay::messages::{AnyMessage, Key, key};
use lab::replay::rebuild::Mover;
use lab::replay::rehearsal::{self, Rehearsal, Trouble, config};
use lab::replay::run::{PROCESSES, Replayed, Task, replay};
use lab::replay::source::InMemory;
use lab::replay::ticks::build;
use shm_config::Instant;
use shm_config::config::planner::Method;
use shm_config::config::{Config, GateMode};
use shm_config::draw::Draw;
use shm_config::layout::Layout;
use shm_config::message::Message;

fn clock() -> Instant {
    Instant(0)
}

fn task() -> Task {
    Task {
        processes: PROCESSES.to_vec(),
        from: 0,
        tick: None,
    }
}

fn replayed(run: &mut InMemory) -> Replayed {
    run.at = 0;
    replay(run, &task(), clock, |_| {}).expect("a replay")
}

/// A run in real time with everything going wrong.
fn troubled(seed: u64, ticks: usize) -> InMemory {
    let run = Rehearsal::troubled(seed).and_then(|run| run.run(ticks));
    run.expect("a rehearsal")
}

/// A run of this configuration.
fn rehearsed(config: Config, trouble: Trouble, ticks: usize) -> InMemory {
    let seed = config.run.seed;
    let run = Rehearsal::new(config, seed, trouble).and_then(|run| run.run(ticks));
    run.expect("a rehearsal")
}

#[test]
fn a_troubled_run_in_real_time_is_recomputed_bit_by_bit() {
    let mut recomputed = [0; PROCESSES.len()];
    for seed in 0..8 {
        let mut run = troubled(seed, 600);
        let found = replayed(&mut run);
        assert_eq!(found.first_difference, None, "seed {seed}");
        assert!(found.missing_policies.is_empty(), "seed {seed}");
        assert!(found.ticks > 400, "seed {seed}: {}", found.ticks);
        for row in &found.processes {
            let at = PROCESSES
                .iter()
                .position(|process| process.word() == row.process);
            recomputed[at.expect("a process")] += row.tally.recomputed;
            let most = found.ticks / 10;
            assert!(row.tally.unknown <= most, "seed {seed}: {row:?}");
        }
    }
    let [others @ .., learner] = recomputed;
    assert!(others.iter().all(|count| *count > 1_000), "{others:?}");
    assert_eq!(learner, 0, "there is none in these runs");
}

#[test]
fn every_planner_is_recomputed_with_its_memory() {
    for method in [Method::Informed, Method::Kinodynamic, Method::Mpc] {
        let mut config = config(11, GateMode::Expert);
        config.planner.method = method;
        let mut run = rehearsed(config, Trouble::All, 150);
        let found = replayed(&mut run);
        assert_eq!(found.first_difference, None, "{method:?}");
    }
}

#[test]
fn a_recording_longer_than_a_stretch_is_recomputed() {
    let mut run = rehearsed(config(5, GateMode::Rules), Trouble::All, 7_000);
    let found = replayed(&mut run);
    assert_eq!(found.first_difference, None);
    assert!(found.ticks > 5_000, "{}", found.ticks);
}

/// The service and the number of a message that a tick may read.
fn number(message: &AnyMessage) -> Option<(&'static str, Key)> {
    match message {
        AnyMessage::Observation(message) => Some(("observation", key(&message.header))),
        AnyMessage::Plan(message) => Some(("plan", key(&message.header))),
        AnyMessage::Command(message) => Some(("command", key(&message.header))),
        AnyMessage::Advice(message) => Some(("advice", key(&message.header))),
        AnyMessage::Takeover(message) => Some(("takeover", key(&message.header))),
        _ => None,
    }
}

/// The messages that some tick had: of the others nothing follows.
fn read_by_ticks(messages: &[AnyMessage]) -> HashSet<(&'static str, Key)> {
    let steps = messages.iter().filter_map(|message| match message {
        AnyMessage::Step(step) => Some(step),
        _ => None,
    });
    let read = steps.flat_map(|step| {
        [
            ("observation", key(&step.observation.header)),
            ("plan", key(&step.plan.header)),
            ("command", key(&step.command.header)),
            ("advice", key(&step.advice.header)),
            ("takeover", key(&step.takeover.header)),
        ]
    });
    read.collect()
}

/// Flips one bit of a message's bytes after its header's first field.
fn flip<M: Message + Layout>(message: &mut M, draw: &mut Draw) -> usize {
    let mut bytes = message.as_bytes().to_vec();
    let at = draw.below(8 * bytes.len() as u64) as usize;
    bytes[at / 8] ^= 1 << (at % 8);
    *message = M::from_bytes(&bytes).expect("as many bytes");
    at / 8
}

#[test]
fn a_flipped_bit_in_what_a_tick_reads_is_found_and_named() {
    let mut clean = troubled(1, 300);
    assert_eq!(replayed(&mut clean).first_difference, None);
    let mut draw = Draw::new(77);
    let inner = clean.messages.len() / 10..clean.messages.len() * 9 / 10;
    let read = read_by_ticks(&clean.messages);
    for case in 0..60 {
        let mut run = clean.clone();
        let (at, process, byte) = loop {
            let at = inner.start + draw.below(inner.len() as u64) as usize;
            if !number(&run.messages[at]).is_some_and(|number| read.contains(&number)) {
                continue;
            }
            let flipped = match &mut run.messages[at] {
                AnyMessage::Observation(message) => ("world", flip(message, &mut draw)),
                AnyMessage::Plan(message) => ("planner", flip(message, &mut draw)),
                AnyMessage::Command(message) => ("controller", flip(message, &mut draw)),
                AnyMessage::Advice(message) => ("gate", flip(message, &mut draw)),
                AnyMessage::Takeover(message) => ("supervisor", flip(message, &mut draw)),
                _ => continue,
            };
            break (at, flipped.0, flipped.1);
        };
        let found = replayed(&mut run);
        let first = found.first_difference;
        let what = format!("case {case}: message {at} of {process}, byte {byte}");
        let first = first.unwrap_or_else(|| panic!("{what}: not found"));
        assert!(
            !first.field.is_empty() && first.recorded != first.recomputed,
            "{what}: {first:?}"
        );
    }
}

#[test]
fn a_flipped_bit_in_a_steps_inputs_is_found_and_named() {
    let clean = troubled(1, 300);
    let mut draw = Draw::new(78);
    let steps: Vec<usize> = (clean.messages.iter().enumerate())
        .filter(|(_, message)| matches!(message, AnyMessage::Step(_)))
        .map(|(at, _)| at)
        .collect();
    for case in 0..40 {
        let mut run = clean.clone();
        let at = steps[20 + draw.below(steps.len() as u64 - 40) as usize];
        let AnyMessage::Step(step) = &mut run.messages[at] else {
            panic!("a step");
        };
        let part = match case % 5 {
            0 => ("before", flip_part(&mut step.before, &mut draw)),
            1 => ("observation", flip(&mut step.observation, &mut draw)),
            2 => ("plan", flip(&mut step.plan, &mut draw)),
            3 => ("advice", flip(&mut step.advice, &mut draw)),
            _ => ("command", flip(&mut step.command, &mut draw)),
        };
        let tick = step.header.tick;
        let never_came = step.advice.header.producer == 0;
        if part.0 == "advice" && never_came {
            continue;
        }
        let what = format!("case {case}: {}, byte {}, tick {tick}", part.0, part.1);
        let found = replayed(&mut run).first_difference;
        let found = found.unwrap_or_else(|| panic!("{what}: not found"));
        assert_eq!(
            (found.process, found.tick),
            ("controller", tick),
            "{what}: {found:?}"
        );
        assert!(found.field.starts_with(part.0), "{what}: {found:?}");
    }
}

fn flip_part<L: Layout + Copy>(part: &mut L, draw: &mut Draw) -> usize {
    let mut bytes = part.as_bytes().to_vec();
    let at = draw.below(8 * bytes.len() as u64) as usize;
    bytes[at / 8] ^= 1 << (at % 8);
    assert!(part.copy_from(&bytes), "as many bytes");
    at / 8
}

#[test]
fn a_fork_without_a_change_is_the_recording_to_its_end() {
    let mut draw = Draw::new(3);
    for seed in 0..16 {
        let mut run = troubled(seed, 250);
        let last = run
            .messages
            .iter()
            .filter_map(tick_of)
            .max()
            .expect("ticks");
        let tick = draw.below(last.saturating_sub(20));
        let what = format!("seed {seed}, tick {tick}");
        let course = Course::read(&mut run, tick, Until::End).expect(&what);
        let mover = Mover::new(&course.config);
        let first = course.beginning(course.at);
        let rebuilt = course.rebuild(&mover, (first, course.at), |_, _| {});
        let rebuilt = rebuilt.unwrap_or_else(|error| panic!("{what}: {error:#}"));
        let policies = run
            .policies
            .iter()
            .map(|policy| build(policy, &course.config, clock).expect("a policy"));
        let recomputer = controller::Recomputer::with_policies(&course.config, policies.collect());
        let mut own = Unchanged::new(&course, &mover, recomputer).expect(&what);
        own.drive(rebuilt)
            .unwrap_or_else(|error| panic!("{what}: {error:#}"));
        assert_eq!(own.difference, None, "{what}");
        assert!(own.ticks > 5, "{what}: {} ticks", own.ticks);
    }
}

fn tick_of(message: &AnyMessage) -> Option<u64> {
    match message {
        AnyMessage::Observation(observation) => Some(observation.header.tick),
        _ => None,
    }
}

#[test]
fn a_fork_drives_on_with_another_planner() {
    let mut run = rehearsed(config(3, GateMode::Expert), Trouble::None, 120);
    let course = Course::read(&mut run, 40, Until::Episode).expect("a course");
    let mover = Mover::new(&course.config);
    let first = course.beginning(course.at);
    let rebuilt = course
        .rebuild(&mover, (first, course.at), |_, _| {})
        .expect("a world");
    let mut other = course.config.clone();
    other.planner.method = Method::Kinodynamic;
    let digests: Vec<_> = [&course.config, &other]
        .map(|config: &Config| {
            let drive = Drive {
                config,
                mover: &mover,
                seconds: 5.0,
                clock,
            };
            let begun = start(&course, course.at, &rebuilt, &course.config);
            let driven = drive.run(begun, Wheel::Stack(None)).expect("a drive");
            assert_eq!(driven.ticks, 50);
            assert!(driven.reasons.values().sum::<u64>() == 50);
            driven.episode.command_digest
        })
        .to_vec();
    assert_ne!(digests[0], digests[1], "another planner drives differently");
}

#[test]
fn a_changed_command_leads_to_a_world_that_is_not_the_recorded_one() {
    let mut run = rehearsed(config(3, GateMode::Expert), Trouble::None, 80);
    let at = run.messages.iter().position(
        |message| matches!(message, AnyMessage::Observation(seen) if seen.header.tick == 30),
    );
    if let Some(AnyMessage::Observation(seen)) = at.map(|at| &mut run.messages[at]) {
        seen.ego.x_world_m += 1e-9;
    }
    let course = Course::read(&mut run, 60, Until::Episode).expect("a course");
    let mover = Mover::new(&course.config);
    let error = course.rebuild(&mover, (course.beginning(course.at), course.at), |_, _| {});
    let error = error.err().expect("a difference").to_string();
    assert!(
        error.contains("tick 30") && error.contains("ego.x_world_m"),
        "{error}"
    );
}

/// The exit code of a command of the program, what it printed, and its JSON.
fn lab(words: &[&str], folder: &Path) -> (Option<i32>, String, serde_json::Value) {
    let json = folder.join("figures.json");
    let output = Command::new(env!("CARGO_BIN_EXE_vlaps-lab"))
        .args(words)
        .args(["--json".as_ref(), json.as_os_str()])
        .output()
        .expect("the program starts");
    let printed = [output.stdout, output.stderr].concat();
    let text = std::fs::read_to_string(&json).unwrap_or_default();
    let figures = serde_json::from_str(&text).unwrap_or_default();
    (
        output.status.code(),
        String::from_utf8_lossy(&printed).into_owned(),
        figures,
    )
}

/// A recording of the troubled run in `folder`: the run, its file, and the
/// recording's path as a word of a command line.
fn recorded(folder: &Path) -> (InMemory, PathBuf, String) {
    let recording = folder.join("recording");
    std::fs::create_dir(&recording).expect("a folder");
    let path = recording.join("run-0001.mcap");
    let run = troubled(1, 260);
    run.save(&path).expect("a recording");
    (run, path, recording.display().to_string())
}

#[test]
fn the_commands_replay_and_fork_a_recording_on_disk() {
    let folder = tempfile::tempdir().expect("a folder");
    let (_, _, rec) = recorded(folder.path());

    let (code, printed, figures) = lab(&["replay", &rec], folder.path());
    assert_eq!(code, Some(0), "{printed}");
    assert_eq!(figures["different"], 0, "{printed}");
    assert!(figures["ticks"].as_u64() > Some(150) && figures["first_difference"].is_null());

    let (code, printed, figures) = lab(&["fork", &rec, "--tick", "40"], folder.path());
    assert_eq!(code, Some(0), "{printed}");
    assert_eq!(figures["identical"], true, "{printed}");

    let other = ["--driver", "kinodynamic", "--seconds", "2"];
    let words = [&["fork", &rec, "--tick", "40"][..], &other].concat();
    let (code, printed, figures) = lab(&words, folder.path());
    assert_eq!(code, Some(0), "{printed}");
    assert!(
        figures["identical"].is_null() && figures["ticks"] == 20,
        "{printed}"
    );

    let plot = folder.path().join("asked.svg").display().to_string();
    let asked = ["--set", "planner.speed_mps=4.0", "--plot", &plot];
    let words = [&["replay", &rec][..], &asked].concat();
    let (code, printed, figures) = lab(&words, folder.path());
    assert_eq!(code, Some(0), "{printed}");
    assert!(figures["different"].as_u64() > Some(0), "{printed}");
    assert!(Path::new(&plot).is_file());
}

#[test]
fn regress_exits_with_1_exactly_when_a_row_is_worse() {
    let folder = tempfile::tempdir().expect("a folder");
    let (_, _, rec) = recorded(folder.path());
    let policy = folder.path().join("policy.onnx");
    std::fs::write(&policy, rehearsal::policy_file(9).expect("weights").bytes).expect("a policy");
    let words = ["regress", &rec, "--policy", &policy.display().to_string()];
    let (code, printed, figures) = lab(&words, folder.path());
    let rows = figures["rows"].as_array().map_or(0, Vec::len);
    assert!(rows > 0, "{printed}");
    let worse = figures["worse"].as_u64();
    assert_eq!(code, Some(i32::from(worse > Some(0))), "{printed}");
}

#[test]
fn a_recording_that_differs_in_the_last_digits_is_not_called_identical() {
    let folder = tempfile::tempdir().expect("a folder");
    let (run, path, rec) = recorded(folder.path());
    let half = run.messages.len() / 2;

    let mut flipped = run.clone();
    let mut later = flipped.messages[half..].iter_mut();
    let step = later.find_map(|message| match message {
        AnyMessage::Step(step) => Some(step),
        _ => None,
    });
    step.expect("a step").expert.steer += 1e-12;
    flipped.save(&path).expect("a recording");
    let (code, printed, figures) = lab(&["fork", &rec, "--tick", "40"], folder.path());
    assert_eq!(code, Some(1), "{printed}");
    assert_eq!(figures["identical"], false, "{printed}");
    assert_eq!(
        figures["first_difference"]["field"], "expert.steer",
        "{printed}"
    );

    let mut flipped = run;
    let mut later = flipped.messages[half..].iter_mut();
    let command = later.find_map(|message| match message {
        AnyMessage::Command(command) => Some(command),
        _ => None,
    });
    command.expect("a command").steer += 1e-12;
    flipped.save(&path).expect("a recording");
    let (code, printed, figures) = lab(&["replay", &rec], folder.path());
    assert_eq!(code, Some(1), "{printed}");
    assert_eq!(
        figures["first_difference"]["field"], "command.steer",
        "{printed}"
    );
}

#[test]
fn a_recording_or_tick_that_is_not_there_is_one_line_and_exit_code_2() {
    let folder = tempfile::tempdir().expect("a folder");
    let (_, _, rec) = recorded(folder.path());
    let (code, printed, _) = lab(&["replay", "no-such-recording"], folder.path());
    assert_eq!(code, Some(2), "{printed}");
    assert_eq!(printed.trim().lines().count(), 1, "{printed}");
    let (code, printed, _) = lab(&["fork", &rec, "--tick", "99999999"], folder.path());
    assert_eq!(code, Some(2), "{printed}");
}
