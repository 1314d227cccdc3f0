//! Keys and hostile text, in real process sets: who can read a key, and what a
//! terminal, a log or a page gets to see of what a server, a path or a file says.

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::{Arc, Mutex};
use std::thread;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::json;
use vlaps_tests::{Set, programs, until};

const KEY: &str = "sk-test-4f1d77-never-to-be-seen";
const OTHER_KEY: &str = "sk-other-9b02e3-never-to-be-seen";
const OWN_KEY: &str = "sk-own-c55a10-never-to-be-seen";
const KEYS: [&str; 3] = [KEY, OTHER_KEY, OWN_KEY];

/// Stands in the environment as the keys do, and may be seen.
const MARKER: &str = "anybody-may-see-77812";

/// An escape sequence, C1's, an override and an isolate of direction, zero width.
const HOSTILE: &str = "red\u{1b}[31m c1\u{9b}2J rlo\u{202e} lri\u{2066} zero\u{200b}\u{feff}width";
const RAW: [char; 6] = [
    '\u{1b}', '\u{9b}', '\u{202e}', '\u{2066}', '\u{200b}', '\u{feff}',
];

fn is_raw(text: &str) -> bool {
    text.contains(RAW)
}

fn holds(bytes: &[u8], word: &str) -> bool {
    let word = word.as_bytes();
    let starts = bytes.iter().enumerate().filter(|(_, b)| **b == word[0]);
    starts
        .into_iter()
        .any(|(at, _)| bytes[at..].starts_with(word))
}

/// A policy that was trained for 9,800 steps: something to judge.
fn policy() -> String {
    let file = "../results/learning/ppl-10000.onnx";
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
    path.display().to_string()
}

/// How a server answers a request with this `Authorization`.
type Answer = fn(&str) -> (&'static str, String);

/// A server that remembers which keys it was sent.
struct Server {
    url: String,
    sent: Arc<Mutex<Vec<String>>>,
}

impl Server {
    fn start(answer: Answer) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("an address");
        let sent = Arc::new(Mutex::new(Vec::new()));
        let keep = sent.clone();
        thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let keep = keep.clone();
                // One that goes away in the middle of a request is none.
                thread::spawn(move || serve(stream, answer, &keep));
            }
        });
        Self {
            url: format!("http://{address}/v1"),
            sent,
        }
    }

    fn was_sent(&self, key: &str) -> usize {
        let sent = self.sent.lock().expect("whole");
        sent.iter().filter(|one| one.contains(key)).count()
    }
}

fn serve(stream: TcpStream, answer: Answer, keep: &Mutex<Vec<String>>) -> Option<()> {
    let mut reader = BufReader::new(stream.try_clone().ok()?);
    let (mut authorization, mut length) = (String::new(), 0);
    loop {
        let mut line = String::new();
        reader
            .read_line(&mut line)
            .ok()
            .filter(|bytes| *bytes > 0)?;
        let Some((name, value)) = line.trim_end().split_once(": ") else {
            if line.trim_end().is_empty() {
                break;
            }
            continue;
        };
        match name.to_ascii_lowercase().as_str() {
            "authorization" => authorization = value.into(),
            "content-length" => length = value.parse().ok()?,
            _ => {}
        }
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body).ok()?;
    let (status, text) = answer(&authorization);
    keep.lock().ok()?.push(authorization);
    let head = format!(
        "HTTP/1.1 {status}\r\ncontent-type: application/json\r\ncontent-length: {}\r\n\
         connection: close\r\n\r\n",
        text.len()
    );
    let mut stream = stream;
    stream.write_all(head.as_bytes()).ok()?;
    stream.write_all(text.as_bytes()).ok()
}

/// Refuses for good, and repeats the key among words that act on a terminal.
fn refuses(authorization: &str) -> (&'static str, String) {
    let message = format!("{HOSTILE}: incorrect key: {authorization}");
    let body = json!({"error": {"message": message, "code": "invalid_api_key"}});
    ("401 Unauthorized", body.to_string())
}

/// Answers with words that are no answer, from a model of such a name.
fn babbles(_: &str) -> (&'static str, String) {
    let body = json!({
        "model": HOSTILE,
        "choices": [{"message": {"content": HOSTILE}, "finish_reason": "stop"}],
        "usage": {"prompt_tokens": 10, "completion_tokens": 10},
    });
    ("200 OK", body.to_string())
}

/// Process ids of all that work in a folder or below it.
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

/// No process that works in the folder shows a key; how many were looked at.
fn look_at_processes(folder: &Path) -> usize {
    let pids = processes(folder);
    for pid in &pids {
        for file in ["environ", "cmdline"] {
            // Of a gate that is not dumpable only root may read.
            let bytes = fs::read(format!("/proc/{pid}/{file}")).unwrap_or_default();
            let name = fs::read_to_string(format!("/proc/{pid}/comm")).unwrap_or_default();
            for key in KEYS {
                assert!(!holds(&bytes, key), "{file} of {pid}, {}", name.trim());
            }
        }
    }
    pids.len()
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files = Vec::new();
    for path in entries.map(|entry| entry.path()) {
        match path.is_dir() {
            true => files.extend(files_below(&path)),
            false => files.push(path),
        }
    }
    files
}

/// No file of the run holds a key; how many were looked at.
fn look_at_files(set: &Set) -> usize {
    let mut files = files_below(set.folder());
    files.extend(files_below(&set.paths().dir()));
    files.extend(set.paths().shared_memory().expect("/dev/shm"));
    for file in &files {
        // Sockets and what has gone meanwhile have no content.
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

    // What dies leaves no memory of the key behind, and its successor gets it anew.
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

/// Where a core file is written; that of the gate would have been, too.
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
    let mut bench = Command::new(programs().join("vlaps-supervisor"))
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
    until("the gate uses the key", || {
        let ended = bench.try_wait().expect("a child");
        assert_eq!(ended, None, "it ended too early");
        server.was_sent(KEY) > 0
    });
    assert_eq!(look_at_processes(&place), 6, "the bench and a set of five");
    kill_process(Pid::from_child(&bench), Signal::TERM).expect("it lives");
    bench.wait().expect("an end");
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
        said.contains("VLAPS_VLM_KEY: no key: must be one word"),
        "{said}"
    );
    assert!(!said.contains("kkkk"), "{said}");
}

fn said(output: &Output) -> String {
    let parts = [&output.stdout, &output.stderr];
    parts
        .map(|part| String::from_utf8_lossy(part).into_owned())
        .concat()
}

/// Drives a set that is judged by a server with hostile words, and gives all that is
/// to be read afterwards, by name.
fn readings(label: &str, answer: Answer) -> Vec<(String, String)> {
    let server = Server::start(answer);
    let set = Set::new(label);
    let (address, policy) = (format!("vlm.server={}", server.url), policy());
    let model = format!("vlm.model={HOSTILE}");
    let output = set
        .up_command(
            &[],
            &[
                "--lockstep",
                "--seed",
                "1003",
                "--duration",
                "12",
                "--policy",
                &policy,
                "--gate",
                "vlm",
                "--set",
                &address,
                "--set",
                "vlm.attempts_max=1",
                "--set",
                &model,
            ],
        )
        .env("VLAPS_VLM_KEY", KEY)
        .output()
        .expect("the supervisor starts");
    assert!(output.status.success(), "{}", said(&output));
    assert!(server.was_sent(KEY) > 0, "it was asked");
    let run = set.folder().join("runs").join(set.name().to_string());
    let audit = Command::new(programs().join("vlaps-judge"))
        .arg("audit")
        .arg(&run)
        .output()
        .expect("the audit starts");
    assert!(audit.status.success(), "{}", said(&audit));
    look_at_files(&set);
    let is_text = |file: &PathBuf| {
        let end = file.extension().unwrap_or_default().to_string_lossy();
        ["log", "html", "json", "jsonl", "csv"].contains(&&*end)
    };
    let files = files_below(set.folder()).into_iter().filter(is_text);
    let mut readings: Vec<_> = files
        .map(|file| {
            let bytes = fs::read(&file).unwrap_or_default();
            let name = file.file_name().unwrap_or_default().display().to_string();
            (name, String::from_utf8_lossy(&bytes).into_owned())
        })
        .collect();
    readings.push(("output".into(), said(&output)));
    readings.push(("output of the audit".into(), said(&audit)));
    readings
}

#[test]
fn what_a_server_says_is_shown_and_acts_on_nothing() {
    for (label, answer, shown_in) in [
        (
            "refuses",
            refuses as Answer,
            &["output", "gate.log", "audit.html"][..],
        ),
        ("babbles", babbles, &["audit.html"]),
    ] {
        let readings = readings(label, answer);
        for (name, text) in &readings {
            assert!(!is_raw(text), "{label}, {name}: {}", text.escape_debug());
        }
        for expected in shown_in {
            let found = readings.iter().find(|(name, _)| name == expected);
            let (_, text) = found.unwrap_or_else(|| panic!("{label}: no {expected}"));
            // The log's own library writes escape sequences in another way.
            let shown = "rlo\\u{202e} lri\\u{2066} zero\\u{200b}\\u{feff}";
            assert!(text.contains(shown), "{label}, {expected}: {text}");
        }
        let records = readings.iter().find(|(name, _)| name == "questions.jsonl");
        let (_, records) = records.expect("records");
        let record = records.lines().next().expect("a record");
        let record: serde_json::Value = serde_json::from_str(record).expect("JSON");
        let kept = record["askings"][0]["said"]
            .as_str()
            .expect("what was said");
        assert!(
            kept.contains(HOSTILE),
            "a record keeps what was said: {kept}"
        );
    }
}

#[test]
fn what_a_path_or_a_key_holds_is_shown_and_acts_on_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let unknown = format!("[vlm]\n{} = 1\n", json!(HOSTILE));
    fs::write(folder.path().join("unknown.toml"), unknown).expect("written");
    let value = format!("[vlm]\ndialect = {}\n", json!(HOSTILE));
    fs::write(folder.path().join("value.toml"), value).expect("written");
    let missing = format!("{HOSTILE}.toml");
    let setting = format!("vlm.{HOSTILE}=1");
    let option = format!("--{HOSTILE}");
    let nowhere = format!("{HOSTILE}/x.json");
    let cases: [(&str, Vec<&str>); 12] = [
        ("vlaps-supervisor", vec!["up", "--policy", &missing]),
        ("vlaps-bench", vec!["eval", "--json", &nowhere]),
        ("vlaps-supervisor", vec!["up", "--config", &missing]),
        ("vlaps-supervisor", vec!["up", "--config", "unknown.toml"]),
        ("vlaps-supervisor", vec!["up", "--config", "value.toml"]),
        ("vlaps-supervisor", vec!["up", "--set", &setting]),
        ("vlaps-supervisor", vec!["up", &option]),
        ("vlaps-supervisor", vec!["status", "--run", HOSTILE]),
        ("vlaps-supervisor", vec!["eval", "--config", &missing]),
        ("vlaps-bench", vec!["eval", &option]),
        ("vlaps-judge", vec!["audit", HOSTILE]),
        ("vlaps-planner", vec!["--config", "unknown.toml"]),
    ];
    for (program, words) in cases {
        let output = Command::new(programs().join(program))
            .args(&words)
            .current_dir(folder.path())
            .stdin(Stdio::null())
            .output()
            .expect("it starts");
        let said = said(&output);
        assert!(!output.status.success(), "{program} {words:?}: {said}");
        assert!(
            !is_raw(&said),
            "{program} {words:?}: {}",
            said.escape_debug()
        );
        let is_shown = said.contains("red\\u{1b}[31m c1\\u{9b}2J rlo\\u{202e}");
        assert!(is_shown, "{program} {words:?}: {said}");
    }
}

#[test]
fn an_unknown_key_as_long_as_a_file_is_refused_in_a_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("long.toml");
    fs::write(&path, format!("{} = 1\n", "k".repeat(900_000))).expect("written");
    let output = Command::new(programs().join("vlaps-supervisor"))
        .args(["up", "--config"])
        .arg(&path)
        .output()
        .expect("it starts");
    let said = said(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(
        said.contains("unknown key 'kkk") && said.len() < 4096,
        "{}",
        said.len()
    );
}
