//! A real set recorded: each message that was published is in the recording or counted as
//! lost, and readers of other projects decode it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use recorder::Recording;
use rustix::process::Signal;
use shm_config::layout::Layout;
use shm_config::message::{Header, Message};
use shm_config::services::{COMMAND, OBSERVATION, PLAN, STEP, Service};
use vlaps_tests::{Set, programs, until};

/// Messages by service: recorded, and published as the largest sequence number of each
/// producer says.
fn counts(recording: &Recording) -> BTreeMap<String, (u64, u64)> {
    let mut last: BTreeMap<(String, u32), (u64, u64)> = BTreeMap::new();
    for entry in recording.entries() {
        let entry = entry.expect("whole");
        let header = entry.header().expect("a header");
        let of = last
            .entry((entry.channel.service.clone(), header.producer))
            .or_default();
        of.0 += 1;
        assert!(
            header.sequence > of.1,
            "{}: in order, once each",
            entry.channel.service
        );
        of.1 = header.sequence;
    }
    let mut counts = BTreeMap::<_, (u64, u64)>::new();
    for ((service, _), (there, published)) in last {
        let of = counts.entry(service).or_default();
        of.0 += there;
        of.1 += published;
    }
    counts
}

fn recorded(set: &Set, arguments: &[&str]) -> (Recording, serde_json::Value) {
    let all = [&["--seed", "3", "--record", "rec"], arguments].concat();
    let output = set.run(&all);
    assert!(output.status.success(), "{output:?}\n{}", set.logs());
    let recording = Recording::open(&set.folder().join("rec")).expect("a recording");
    assert_eq!(recording.damage().collect::<Vec<_>>(), Vec::<&str>::new());
    (recording, set.json())
}

#[test]
fn a_set_in_real_time_is_recorded_or_its_losses_are_counted() {
    let set = Set::new("rec");
    let (recording, json) = recorded(&set, &["--duration", "4", "--rate", "50"]);
    let counts = counts(&recording);
    let row = &json["processes"]["recorder"];
    // The roster is published before any process starts.
    let others = counts.iter().filter(|(service, _)| *service != "roster");
    let lost: u64 = others
        .map(|(_, (there, published))| published - there)
        .sum();
    let told = row["lost"].as_u64().unwrap_or_else(|| panic!("{row}"));
    assert_eq!(lost, told, "{counts:?}");
    for service in [
        "observation",
        "plan",
        "command",
        "step",
        "progress",
        "health/world",
    ] {
        assert!(counts[service].0 > 0, "{service}: {counts:?}");
    }
    assert_eq!(
        json["processes"]["controller"]["ticks"].as_u64(),
        Some(counts["step"].1),
        "a step for each tick"
    );
    let text = recording
        .configuration()
        .expect("readable")
        .expect("attached");
    assert!(text.contains("rate_hz = 50"), "{text}");
    let origin = recording.origin();
    assert!(!origin.is_lockstep && origin.run == set.name().to_string());
    assert_eq!(origin.fact("binary.vlaps-controller").len(), 64);
}

#[test]
fn a_set_in_lockstep_is_recorded_whole_and_drives_as_without() {
    let plain = Set::new("plain");
    let arguments = ["--lockstep", "--episodes", "1"];
    let output = plain.run(&[&["--seed", "3"], &arguments[..]].concat());
    assert!(output.status.success(), "{output:?}\n{}", plain.logs());
    let set = Set::new("lockrec");
    let (recording, json) = recorded(&set, &arguments);
    assert_eq!(json["command_digest"], plain.json()["command_digest"]);
    let counts = counts(&recording);
    for service in ["observation", "plan", "command", "step"] {
        let (there, published) = counts[service];
        assert_eq!(there, published, "{service}: {counts:?}");
    }
    let ticks = json["ticks"].as_u64().expect("ticks");
    assert!(counts["step"].0 >= ticks, "{counts:?}");
    let steps = recording.messages(&STEP).expect("of this layout");
    let ticks: Vec<_> = steps.map(|step| step.expect("whole").header.tick).collect();
    assert!(ticks.is_sorted());
    let middle = ticks[ticks.len() / 2];
    let mut from = recording.entries().from_tick(middle).expect("readable");
    let first = from.next().expect("an entry").expect("whole");
    assert!(first.is(&OBSERVATION), "{}", first.channel.service);
    assert_eq!(first.header().expect("a header").tick, middle);
    every_input_of_a_step_is_there(&recording);
    let channels = recording.channels();
    let shown = channels.iter().find(|channel| channel.service == "tf");
    assert_eq!(shown, None, "topics for viewers are no services");
    decode_in_python(&set.folder().join("rec"));
}

/// The last messages included, which no later number shows to be missing.
fn every_input_of_a_step_is_there(recording: &Recording) {
    fn keys<M: Message + Layout>(recording: &Recording, service: &Service<M>) -> BTreeSet<Key> {
        let messages = recording.messages(service).expect("of this layout");
        let keys = messages.map(|message| key(message.expect("whole").header()));
        keys.collect()
    }
    let known = [
        keys(recording, &OBSERVATION),
        keys(recording, &PLAN),
        keys(recording, &COMMAND),
    ];
    let mut inputs = 0;
    for step in recording.messages(&STEP).expect("of this layout") {
        let step = step.expect("whole");
        let headers = [
            step.observation.header,
            step.plan.header,
            step.command.header,
        ];
        for (header, known) in headers.iter().zip(&known) {
            // A tick may have no plan, and one that is held back sends no command.
            let is_none = header.producer == 0 || header.sequence == 0;
            assert!(is_none || known.contains(&key(header)), "{header:?}");
            inputs += usize::from(!is_none);
        }
    }
    assert!(inputs > 1_000, "{inputs}");
}

/// The producer and the number of a message.
type Key = (u32, u64);

fn key(header: &Header) -> Key {
    (header.producer, header.sequence)
}

/// A recorder that is killed is started again, and nothing of the run waits for it.
#[test]
fn a_killed_recorder_goes_on_in_a_new_file() {
    let mut set = Set::new("reckill");
    set.start(&["--duration", "8", "--rate", "50", "--record", "rec"]);
    let folder = set.folder().join("rec");
    let steps = || {
        let recording = Recording::open(&folder).ok()?;
        Some(
            recording
                .messages(&STEP)
                .ok()?
                .filter(Result::is_ok)
                .count(),
        )
    };
    until("steps are on the disk", || {
        steps().is_some_and(|count| count > 20)
    });
    assert_eq!(set.signal_program("vlaps-recorder", Signal::KILL), 1);
    assert_eq!(set.wait(), Some(0), "{}", set.logs());
    assert_eq!(set.json()["processes"]["recorder"]["restarts"], 1);
    let recording = Recording::open(&folder).expect("a recording");
    assert!(recording.files().count() >= 2);
    assert_eq!(recording.damage().count(), 1, "the file of the killed one");
    let there = recording
        .messages(&STEP)
        .expect("of this layout")
        .filter(Result::is_ok)
        .count();
    assert!(
        there as u64 > set.json()["ticks"].as_u64().expect("ticks") / 2,
        "{there}"
    );
}

/// The controller waits for the recorder's steps in lockstep, but not for those that were
/// before a restarted recorder.
#[test]
fn a_killed_recorder_does_not_hold_up_a_run_in_lockstep() {
    let mut set = Set::new("reclockkill");
    set.start(&["--lockstep", "--duration", "400", "--record", "rec"]);
    let folder = set.folder().join("rec");
    until("a chunk is on the disk", || {
        Recording::open(&folder).is_ok_and(|recording| recording.span_ns().is_some())
    });
    assert_eq!(set.signal_program("vlaps-recorder", Signal::KILL), 1);
    assert_eq!(set.wait(), Some(0), "{}", set.logs());
    assert_eq!(set.json()["processes"]["recorder"]["restarts"], 1);
    let logs = set.logs();
    assert!(!logs.contains("the recorder is silent"), "{logs}");
    let recording = Recording::open(&folder).expect("a recording");
    let last = recording.files().last().expect("a file").to_path_buf();
    let last = Recording::open(&last).expect("a recording");
    let steps = last.messages(&STEP).expect("of this layout");
    let numbers: Vec<_> = steps
        .map(|step| step.expect("whole").header.sequence)
        .collect();
    let first = numbers[0];
    let expected: Vec<_> = (first..).take(numbers.len()).collect();
    assert_eq!(numbers, expected, "each step after the restart");
    assert!(numbers.len() as u64 > set.json()["ticks"].as_u64().expect("ticks") / 10);
}

#[test]
fn a_folder_with_another_recording_is_refused_in_one_line() {
    let set = Set::new("rectaken");
    drop(recorded(&set, &["--lockstep", "--duration", "1"]));
    let output = set.run(&["--lockstep", "--duration", "1", "--record", "rec"]);
    assert!(!output.status.success());
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(
        said.contains("holds a recording of another start"),
        "{said}"
    );
}

/// Waits for the first step of a running set.
fn until_it_drives(set: &Set) {
    until("the set drives", || {
        set.status_of("controller")["ticks"].as_u64() > Some(10)
    });
}

/// `record` of a running set, to its end.
fn record(set: &Set, arguments: &[&str]) -> Output {
    let mut command = Command::new(programs().join("vlaps-recorder"));
    let name = set.name().to_string();
    command.args(["record", &name]).args(arguments);
    let child = command
        .current_dir(set.folder())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let mut child = child.expect("the recorder starts");
    until("record ends by itself", || {
        child.try_wait().is_ok_and(|status| status.is_some())
    });
    child.wait_with_output().expect("its output")
}

/// Messages come in each turn of the recorder, at this rate.
#[test]
fn a_recording_by_hand_ends_after_its_seconds() {
    let mut set = Set::new("rechand");
    set.start(&["--duration", "30", "--rate", "100"]);
    until_it_drives(&set);
    let output = record(&set, &["--out", "rec", "--seconds", "1"]);
    assert!(output.status.success(), "{output:?}");
    assert!(!set.pids("vlaps-supervisor").is_empty(), "the set runs on");
    let recording = Recording::open(&set.folder().join("rec")).expect("a recording");
    let (first_ns, last_ns) = recording.span_ns().expect("messages");
    let span_s = (last_ns - first_ns) as f64 / 1e9;
    assert!(
        span_s > 0.5 && counts(&recording)["step"].0 > 0,
        "{span_s} s"
    );
}

/// It goes on afterwards.
#[test]
fn the_flight_recorder_writes_its_last_minute_on_command() {
    let mut set = Set::new("recflight");
    let keep = ["--set", "record.keep=flight", "--set", "record.folder=rec"];
    set.start(&[&["--duration", "60", "--rate", "50"], &keep[..]].concat());
    until_it_drives(&set);
    let ordered = || set.status_of("controller")["ticks"].as_u64().unwrap_or(0);
    until("there is something before the order", || ordered() > 30);
    let ordered = ordered();
    let output = record(&set, &["--now"]);
    assert!(output.status.success(), "{output:?}");
    let folder = set.folder().join("rec");
    let command = || {
        let files = fs::read_dir(&folder).into_iter().flatten().flatten();
        let mut paths = files.map(|entry| entry.path());
        let path = paths.find(|path| path.display().to_string().contains("-command-"))?;
        let recording = Recording::open(&path).ok()?;
        let is_complete = recording.damage().next().is_none();
        is_complete.then_some(recording)
    };
    until("the last minute is written", || command().is_some());
    let recording = command().expect("written");
    assert_eq!(recording.origin().fact("event"), "command");
    let (first_ns, last_ns) = recording.span_ns().expect("messages");
    assert!(last_ns - first_ns > 4_000_000_000, "5 s after the order");
    let mut steps = recording.messages(&STEP).expect("of this layout");
    let first = steps.next().expect("a step").expect("whole");
    assert!(first.header.tick < ordered, "and what was before it");
    assert!(counts(&recording)["step"].0 > 50);
    let text = recording.configuration().expect("readable");
    assert!(text.is_some_and(|text| text.contains("flight")));
    assert_eq!(set.pids("vlaps-recorder").len(), 1, "it goes on");
}

/// Reads every message with readers of other projects, where they are installed.
fn decode_in_python(folder: &Path) {
    let python = ["target/python/bin/python", "python3"].map(|name| match name.contains('/') {
        true => Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name),
        false => name.into(),
    });
    let modules = "import mcap_ros2, rosbags";
    let has = |python: &&std::path::PathBuf| {
        let probe = Command::new(python).args(["-c", modules]).output();
        probe.is_ok_and(|output| output.status.success())
    };
    let Some(python) = python.iter().find(has) else {
        let why = "decoding in Python: mcap-ros2-support or rosbags is not installed";
        let _ = writeln!(std::io::stderr(), "skipped: {why}");
        return;
    };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("decode.py");
    for file in fs::read_dir(folder).expect("the recording").flatten() {
        let output = Command::new(python).arg(&script).arg(file.path()).output();
        let output = output.expect("python");
        assert!(output.status.success(), "{output:?}");
        let said = String::from_utf8_lossy(&output.stdout);
        assert!(said.contains("types are equal"), "{said}");
        assert!(said.contains("standard topics are equal"), "{said}");
        assert!(said.contains("'/ros/scene': "), "{said}");
    }
}

/// The cores that each thread of a program of the set may use, as the kernel lists them.
fn cores(set: &Set, program: &str) -> Vec<String> {
    let pids = set.pids(program).into_iter();
    let threads = pids.filter_map(|pid| fs::read_dir(format!("/proc/{pid}/task")).ok());
    let status = |thread: fs::DirEntry| fs::read_to_string(thread.path().join("status")).ok();
    let lists = threads.flatten().flatten().filter_map(status);
    let list = |status: String| {
        let mut lines = status.lines();
        let cores = lines.find_map(|line| line.strip_prefix("Cpus_allowed_list:"))?;
        Some(cores.trim().to_string())
    };
    lists.filter_map(list).collect()
}

/// Whether a list such as `0-2,5` has a core.
fn has(list: &str, core: u32) -> bool {
    list.split(',').any(|part| {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        let number = |text: &str| text.parse::<u32>().expect("a core");
        (number(first)..=number(last)).contains(&core)
    })
}

#[test]
fn no_thread_of_the_recorder_may_use_the_core_of_a_tick() {
    let mut set = Set::new("reccore");
    set.start(&["--duration", "4", "--rate", "100", "--record", "rec"]);
    until("steps are on the disk", || {
        let recording = Recording::open(&set.folder().join("rec"));
        recording.is_ok_and(|recording| recording.counts().contains_key(STEP.name))
    });
    let ticks = ["vlaps-world", "vlaps-planner", "vlaps-controller"].map(|name| cores(&set, name));
    let recorder = cores(&set, "vlaps-recorder");
    assert_eq!(set.wait(), Some(0), "{}", set.logs());
    // A thread of a tick has one core.
    let of_ticks = ticks.iter().flatten();
    let taken: Vec<u32> = of_ticks.filter_map(|list| list.parse().ok()).collect();
    let all = std::thread::available_parallelism().expect("cores").get();
    if taken.is_empty() || all < 2 {
        println!("skipped: the recorder's cores: no core of its own is granted to a tick here");
        return;
    }
    assert!(recorder.len() > 1, "{recorder:?}");
    for list in &recorder {
        assert!(
            !taken.iter().any(|core| has(list, *core)),
            "{list} beside {taken:?}"
        );
    }
}
