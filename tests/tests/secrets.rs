//! Which processes and files can hold a key, in real process sets.

mod server;

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use rustix::process::{Pid, Signal, kill_process};
use server::{KEY, Server, files_below, is_raw, policy, refuses, said};
use vlaps_tests::{Set, programs, until};

const OTHER_KEY: &str = "sk-other-9b02e3-never-to-be-seen";
const OWN_KEY: &str = "sk-own-c55a10-never-to-be-seen";
const KEYS: [&str; 3] = [KEY, OTHER_KEY, OWN_KEY];

/// A marker in the environment that may be visible, unlike the keys.
const MARKER: &str = "visible-to-all-77812";

fn holds(bytes: &[u8], word: &str) -> bool {
    let word = word.as_bytes();
    let starts = bytes.iter().enumerate().filter(|(_, b)| **b == word[0]);
    starts
        .into_iter()
        .any(|(at, _)| bytes[at..].starts_with(word))
}

/// Process ids of all processes that run in a folder or below it.
fn processes(folder: &Path) -> Vec<u32> {
    let entries = fs::read_dir("/proc").expect("/proc").flatten();
    let numbers = entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    numbers
        .filter(|pid: &u32| {
            let place = fs::read_link(format!("/proc/{pid}/cwd"));
            place.is_ok_and(|place| place.starts_with(folder))
        })
        .collect()
}

/// Asserts that no process in the folder shows a key; returns how many were examined.
fn look_at_processes(folder: &Path) -> usize {
    let pids = processes(folder);
    for pid in &pids {
        for file in ["environ", "cmdline"] {
            // Only root can read those of a gate, which is not dumpable.
            let bytes = fs::read(format!("/proc/{pid}/{file}")).unwrap_or_default();
            let name = fs::read_to_string(format!("/proc/{pid}/comm")).unwrap_or_default();
            for key in KEYS {
                assert!(!holds(&bytes, key), "{file} of {pid}, {}", name.trim());
            }
        }
    }
    pids.len()
}

/// Asserts that no file of the run holds a key; returns how many were examined.
fn look_at_files(set: &Set) -> usize {
    let mut files = files_below(set.folder());
    files.extend(files_below(&set.paths().dir()));
    files.extend(set.paths().shared_memory().expect("/dev/shm"));
    for file in &files {
        // Sockets and files that were removed in the meantime have no content.
        let bytes = fs::read(file).unwrap_or_default();
        for key in KEYS {
            assert!(!holds(&bytes, key), "{}", file.display());
        }
    }
    files.len()
}

fn cores(folder: &Path) -> Vec<PathBuf> {
    let is_core = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with("core")
    };
    files_below(folder).into_iter().filter(is_core).collect()
}

fn one(set: &Set, program: &str) -> i32 {
    until(program, || set.pids(program).len() == 1);
    set.pids(program)[0]
}

#[test]
fn the_key_is_in_the_gate_alone_and_in_no_file() {
    let server = Server::start(refuses);
    let mut set = Set::new("key");
    let unlimited = "ulimit -c unlimited; exec \"$0\" \"$@\"";
    let (address, policy) = (format!("vlm.server={}", server.url), policy());
    let mut command = set.up_command(
        &["sh", "-c", unlimited],
        &[
            "--seed",
            "1003",
            "--policy",
            &policy,
            "--gate",
            "vlm",
            "--set",
            &address,
            "--set",
            "vlm.key_env=VLAPS_TEST_KEY",
        ],
    );
    command
        .env("VLAPS_TEST_KEY", OWN_KEY)
        .env("VLAPS_VLM_KEY", KEY)
        .env("OPENAI_API_KEY", OTHER_KEY)
        .env("VLAPS_TEST_MARKER", MARKER)
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    set.start_as(&mut command);
    until("the gate uses the key", || server.was_sent(OWN_KEY) > 0);
    assert_eq!(server.was_sent(KEY), 0, "the configuration names another");
    assert_eq!(look_at_processes(set.folder()), 5, "{}", set.logs());

    let log = set
        .folder()
        .join(format!("runs/{}/logs/supervisor.log", set.name()));
    until("the server's words are told, and escaped", || {
        let text = fs::read_to_string(&log).unwrap_or_default();
        assert!(!is_raw(&text), "{}", text.escape_debug());
        text.contains("it says: red\\u{1b}[31m c1\\u{9b}2J rlo\\u{202e} lri\\u{2066}")
    });

    // A killed gate leaves no core file, and its successor gets the key again.
    let gate = one(&set, "vlaps-gate");
    let asked = server.was_sent(OWN_KEY);
    set.signal_program("vlaps-gate", Signal::ABORT);
    until("another gate", || {
        set.pids("vlaps-gate").iter().any(|pid| *pid != gate)
    });
    until("it uses the key", || server.was_sent(OWN_KEY) > asked);
    let gate_cores = cores(set.folder());
    assert_eq!(gate_cores, Vec::<PathBuf>::new(), "of the gate");
    look_at_processes(set.folder());
    let files = look_at_files(&set);
    assert!(files > 10, "{files} files were looked at");
    look_at_the_core_of_its_supervisor(&mut set);
}

/// The core file of the supervisor shows where core files are written; that of the gate
/// would be there too.
fn look_at_the_core_of_its_supervisor(set: &mut Set) {
    let supervisor = one(set, "vlaps-supervisor");
    set.signal(Signal::ABORT);
    set.wait();
    assert!(!Path::new(&format!("/proc/{supervisor}")).exists());
    let Some(core) = cores(set.folder()).pop() else {
        let pattern = fs::read_to_string("/proc/sys/kernel/core_pattern").unwrap_or_default();
        let _ = writeln!(
            std::io::stderr(),
            "skipped: the supervisor's core file: none is written here, the pattern is {}",
            pattern.trim()
        );
        return;
    };
    let core = fs::read(core).expect("a core file");
    assert!(holds(&core, MARKER), "it holds the environment");
    for key in KEYS {
        assert!(!holds(&core, key), "the supervisor's core file");
    }
}

/// A child that is killed when a test fails.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn the_key_reaches_the_gate_of_a_set_that_another_program_drives() {
    let server = Server::start(refuses);
    let folder = tempfile::tempdir().expect("a folder");
    let place = folder.path().canonicalize().expect("a path");
    let mut words = vec!["bench".into(), "soak".into(), "--out".into(), "soak".into()];
    words.extend(["--ticks".into(), "1000000".into()]);
    for setting in [
        "gate.mode=vlm".into(),
        format!("vlm.server={}", server.url),
        format!("policy.file={}", policy()),
    ] {
        words.extend(["--set".to_string(), setting]);
    }
    let bench = Command::new(programs().join("vlaps-supervisor"))
        .args(words)
        .current_dir(&place)
        .env("TMPDIR", &place)
        .env("VLAPS_VLM_KEY", KEY)
        .env("OPENAI_API_KEY", OTHER_KEY)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("it starts");
    let mut bench = Killed(bench);
    until("the gate uses the key", || {
        let ended = bench.0.try_wait().expect("a child");
        assert_eq!(ended, None, "it ended too early");
        server.was_sent(KEY) > 0
    });
    assert_eq!(look_at_processes(&place), 6, "the bench and a set of five");
    kill_process(Pid::from_child(&bench.0), Signal::TERM).expect("it lives");
    bench.0.wait().expect("an end");
    assert_eq!(server.was_sent(OTHER_KEY), 0, "it is OpenAI's alone");
}

#[test]
fn a_key_that_is_too_long_is_refused_and_not_shown() {
    let set = Set::new("long");
    let policy = policy();
    let output = set
        .up_command(&[], &["--lockstep", "--policy", &policy, "--gate", "vlm"])
        .env("VLAPS_VLM_KEY", "k".repeat(100_000))
        .output()
        .expect("the supervisor starts");
    let said = said(&output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        said.contains("VLAPS_VLM_KEY: no key: a key must be one word"),
        "{said}"
    );
    assert!(!said.contains("kkkk"), "{said}");
}
