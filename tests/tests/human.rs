//! A scripted person takes over in a real process set and gives back.

#[path = "../../policy/tests/bad/mod.rs"]
#[allow(dead_code)]
mod bad;

use std::fs;
use std::process::{Command, Stdio};

use rustix::process::{Pid, Signal, kill_process};
use shm_config::message::{Driver, Message, Reason, Step};
use shm_config::services::{Process, STEP};
use shm_config::wire::Wire;
use vlaps_tests::{Set, skip_unless, until};

/// The default age limit of takeover messages, ns.
const TAKEOVER_AGE_NS: u64 = 300_000_000;
const MS: u64 = 1_000_000;

/// Takes over at 2 s, steers left, brakes, gives back at 4 s.
const KEYS: &str = "2.0 space\n2.2 left\n2.6 left\n2.6 up\n3.2 down\n3.3 down\n4.0 space\n";

/// Any net passes this canary period, and none is rolled back.
const LENIENT: [&str; 4] = [
    "--set",
    "policy.veto_rate_max=1.0",
    "--set",
    "policy.shadow_ticks=3",
];

fn taken_over(step: &Step) -> bool {
    step.reason() == Some(Reason::Takeover)
}

#[test]
fn a_scripted_person_takes_over_and_gives_back_and_every_step_says_so() {
    let mut set = Set::new("human");
    fs::write(set.folder().join("keys.txt"), KEYS).expect("a file");
    fs::write(set.folder().join("policy.onnx"), bad::good(32, 1)).expect("a file");
    let words = ["--seed", "3", "--duration", "7", "--gate", "human"];
    let files = ["--keys", "keys.txt", "--policy", "policy.onnx"];
    set.start(&[&words[..], &files[..], &LENIENT[..], &["--no-realtime"]].concat());
    until("the run is up", || set.pids("vlaps-world").len() == 1);
    assert_eq!(set.pids("vlaps-gate").len(), 0, "no judge is needed");
    let wire = Wire::join(set.name(), Process::Learner).expect("shared memory");
    let mut port = wire.subscriber(STEP).expect("steps");
    let mut steps: Vec<Step> = Vec::new();
    let is_over = |step: &Step| step.header.tick >= 60;
    until("six seconds are driven", || {
        port.update_connections();
        steps.extend(std::iter::from_fn(|| port.receive()));
        steps.last().is_some_and(is_over)
    });
    drop((port, wire));
    assert_eq!(set.wait(), Some(0), "{}", set.logs());

    let said = |step: &Step| (step.driver(), step.reason());
    let by_policy = (Driver::Policy, Some(Reason::Configured));
    let first = steps.iter().position(taken_over).expect("taken over");
    let last = steps.iter().rposition(taken_over).expect("taken over");
    let mut before = steps[..first].iter();
    let mut after = steps[last + 1..].iter();
    assert!(before.any(|step| said(step) == by_policy), "before");
    assert!(after.any(|step| said(step) == by_policy), "after");
    for step in &steps[first..=last] {
        assert_eq!(step.check(), Ok(()));
        if taken_over(step) {
            assert_eq!(step.driver(), Driver::Expert);
            assert_eq!(step.takeover.action(), Some(step.command.action()));
            assert_eq!(step.expert.action(), Some(step.command.action()));
        }
    }
    // Takeovers follow the file from the run's first step on. A tick may be taken late
    // within its period, and the last message before giving back is valid up to its age
    // limit.
    let header = &steps[0].header;
    let begun_ns = header.taken_ns - header.tick.min(20) * 100 * MS;
    let passed_ns = |index: usize| steps[index].header.taken_ns - begun_ns;
    assert!(passed_ns(first) >= 1_800 * MS, "{}", passed_ns(first));
    let latest_ns = 4_100 * MS + TAKEOVER_AGE_NS;
    assert!(passed_ns(last) <= latest_ns, "{}", passed_ns(last));
    let driven = || steps[first..=last].iter().filter(|step| taken_over(step));
    assert!(driven().any(|step| step.command.steer > 0.1), "steers");
    assert!(driven().any(|step| step.command.pedal == -1.0), "brakes");

    let json = set.json();
    let takeovers = json["reasons"]["expert"]["takeover"].as_u64();
    assert!(takeovers >= Some(driven().count() as u64), "{json}");
    assert!(json["share"]["policy"].as_f64() > Some(0.0), "{json}");
}

#[test]
fn takeovers_are_refused_in_lockstep_without_a_terminal_and_in_other_modes() {
    let set = Set::new("nohuman");
    fs::write(set.folder().join("keys.txt"), KEYS).expect("a file");
    fs::write(set.folder().join("bad.txt"), "1 jump\n").expect("a file");
    let rows: [(&[&str], &[&str]); 5] = [
        (
            &["--gate", "human"],
            &["stdin is no terminal", "--keys FILE"],
        ),
        (
            &["--gate", "human", "--keys", "keys.txt", "--lockstep"],
            &["--gate human", "drop --lockstep"],
        ),
        (
            &["--gate", "expert", "--keys", "keys.txt"],
            &["--keys keys.txt", "add --gate human"],
        ),
        (
            &["--gate", "human", "--keys", "bad.txt"],
            &["--keys bad.txt:1", "the key must be"],
        ),
        (
            &["--gate", "human", "--keys", "none.txt"],
            &["--keys none.txt", "No such file"],
        ),
    ];
    for (words, parts) in rows {
        let output = set.run(words);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{words:?}: {text}");
        for part in parts {
            assert!(text.contains(part), "'{part}' is missing in: {text}");
        }
    }
}

/// Runs under `script`, whose terminal is the supervisor's: `stty` reports the same
/// mode before and after the run, and another one during it.
#[test]
fn the_terminal_is_as_it_was_however_the_run_ends() {
    if skip_unless(&["script", "--version"], "script(1) is missing") {
        return;
    }
    let endings = [
        ("ttyint", Some(Signal::INT)),
        ("ttyquit", Some(Signal::QUIT)),
        ("ttyend", None),
    ];
    for (label, signal) in endings {
        let set = Set::new(label);
        let words = ["--gate", "human", "--seed", "3", "--no-realtime"];
        let up = set.up_command(&[], &words);
        let words: Vec<_> = up.get_args().map(|word| word.to_string_lossy()).collect();
        let mut up = format!("'{}' {}", up.get_program().display(), words.join(" "));
        if signal.is_none() {
            up.push_str(" --duration 2");
        }
        let line = format!(
            "stty -g > before; \
             (until grep -qs started runs/*/logs/supervisor.log; do sleep 0.1; done; \
              stty -g < /dev/tty > seen; mv seen meanwhile) & \
             {up}; echo $? > code; stty -g > after"
        );
        let mut terminal = Command::new("script")
            .args(["-qec", &line, "/dev/null"])
            .current_dir(set.folder())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .expect("script(1) runs");
        let file = |name: &str| set.folder().join(name);
        until("the terminal was looked at", || file("meanwhile").exists());
        if let Some(signal) = signal {
            let pid = set.paths().supervisor_pid().expect("it drives");
            let pid = Pid::from_raw(pid as i32).expect("a process id");
            kill_process(pid, signal).expect("it lives");
        }
        terminal.wait().expect("an end");
        let read = |name: &str| fs::read_to_string(file(name)).unwrap_or_default();
        assert_eq!(read("code").trim(), "0", "{label}: {}", set.logs());
        assert!(!read("before").is_empty(), "{label}");
        assert_eq!(read("before"), read("after"), "{label}");
        assert_ne!(read("before"), read("meanwhile"), "{label}");
    }
}
