//! `bench latency` and `bench ipc` on real processes, with nothing installed and no
//! privileges: their counts add up, are stored, and leave nothing behind.

use std::fs;
use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::thread;

use rustix::process::{Pid, Signal, getuid, kill_process, kill_process_group};
use serde_json::Value;
use shm_config::run::{RunPaths, SHARED_MEMORY_DIR, USER_DIR};
use tempfile::TempDir;
use vlaps_tests::{programs, until};

/// Starts it in its own process group, as a terminal does.
fn bench(words: &[&str], out: &Path) -> Child {
    Command::new(programs().join("vlaps-bench"))
        .arg("bench")
        .args(words)
        .current_dir(out)
        // Files that a killed benchmark leaves are removed with the test.
        .env("TMPDIR", out)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .process_group(0)
        .spawn()
        .expect("vlaps-bench")
}

/// A folder in memory. Where these benchmarks keep every core busy, the kernel's threads that
/// write to a disk are served last: one fsync of a run's summary has waited for 13 s.
///
/// All that works in it ends with it, also where the test fails: what still wrote would keep
/// the folder, and the memory, for ever. A folder that a killed test left is removed by the
/// next one.
struct Folder(TempDir);

/// How the folders' names begin; the id of the test's process follows.
const FOLDERS: &str = "vlaps-tests-latency-";

fn folder() -> Folder {
    for entry in fs::read_dir(SHARED_MEMORY_DIR)
        .expect("shared memory")
        .flatten()
    {
        let name = entry.file_name().to_string_lossy().into_owned();
        let test = name
            .strip_prefix(FOLDERS)
            .and_then(|rest| rest.split('-').next());
        if test.is_some_and(|pid| !Path::new("/proc").join(pid).exists()) {
            // Two tests may remove it at once.
            let _ = fs::remove_dir_all(entry.path());
        }
    }
    let prefix = format!("{FOLDERS}{}-", std::process::id());
    let folder = TempDir::with_prefix_in(prefix, SHARED_MEMORY_DIR);
    Folder(folder.expect("a folder"))
}

impl Folder {
    fn path(&self) -> &Path {
        self.0.path()
    }

    /// The living processes that work in it.
    fn workers(&self) -> Vec<Pid> {
        let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
        let works_here = processes.filter(|process| {
            let place = fs::read_link(process.path().join("cwd"));
            place.is_ok_and(|place| place.starts_with(self.path()))
        });
        works_here
            .filter_map(|process| process.file_name().to_str()?.parse::<i32>().ok())
            .filter_map(Pid::from_raw)
            .collect()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        loop {
            let workers = self.workers();
            if workers.is_empty() {
                return;
            }
            for pid in workers {
                // It may have ended meanwhile.
                let _ = kill_process(pid, Signal::KILL);
            }
            thread::yield_now();
        }
    }
}

/// Ctrl-C in the terminal: a signal to every process of the group.
fn interrupt(child: &Child) {
    let group = Pid::from_child(child);
    kill_process_group(group, Signal::INT).expect("a signal");
}

fn output(child: Child) -> Output {
    child.wait_with_output().expect("its end")
}

fn json(path: &Path) -> Value {
    let text = fs::read_to_string(path).expect("the JSON was written");
    serde_json::from_str(&text).expect("JSON")
}

/// Shared memory and folders of the runs of a process that are still there.
fn left_behind(pid: u32) -> Vec<String> {
    let names = |folder: &str| -> Vec<String> {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
        names.collect()
    };
    let mut left = names(SHARED_MEMORY_DIR);
    left.retain(|name| name.starts_with("vlaps-") && name.contains(&format!("-{pid}.")));
    let runs = names(&USER_DIR.replace("{user}", &getuid().as_raw().to_string()));
    let of_run = format!("-{pid}");
    left.extend(runs.into_iter().filter(|name| name.ends_with(&of_run)));
    left
}

const ROWS: &[&str] = &[
    "latency",
    "--load",
    "none,cpu",
    "--rate",
    "100",
    "--seconds",
    "2",
    "--priority",
    "refused",
    "--stress",
    "own",
    "--floor",
    "own",
    // No policy is refused because the test machine is busy.
    "--set",
    "policy.inference_max_us=20000",
    "--out",
    "out",
];

#[test]
fn rows_account_for_every_tick_and_are_kept() {
    let folder = folder();
    let child = bench(ROWS, folder.path());
    let pid = child.id();
    let done = output(child);
    assert!(done.status.success(), "{done:?}");
    let out = folder.path().join("out");
    let measured = json(&out.join("latency.json"));
    let rows = measured["rows"].as_array().expect("rows");
    let besides: Vec<_> = rows.iter().map(|row| row["beside"].as_str()).collect();
    assert_eq!(besides, [Some("none"), Some("cpu")]);
    for row in rows {
        for process in ["world", "controller", "planner"] {
            let of = |key: &str| row[process][key].as_u64().expect("a count");
            let elapsed_s = row[process]["elapsed_s"].as_f64().expect("a time");
            let due = (elapsed_s * 100.0).round() as u64;
            assert_eq!(of("ticks") + of("skipped"), due, "{process}: {row}");
            assert!(of("ticks") > 0, "{process} drove: {row}");
        }
        assert!(row["floor"]["ticks"].as_u64() > Some(50), "{row}");
        assert_eq!(row["controller"]["priority"], "not asked");
    }
    // The picture shows the counts.
    let csv = fs::read_to_string(out.join("rows/100-hz-cpu-ordinary.csv")).expect("raw data");
    let lateness = csv
        .lines()
        .filter(|line| line.starts_with("controller,release_lateness,"));
    let counted: u64 = lateness
        .map(|line| {
            line.split(',')
                .nth(4)
                .expect("a count")
                .parse::<u64>()
                .expect("a number")
        })
        .sum();
    let of = |key: &str| rows[1]["controller"][key].as_u64().expect("a count");
    assert_eq!(counted, of("ticks") + of("skipped"));
    for picture in ["lateness-ordinary", "response-ordinary"] {
        for ending in ["svg", "png"] {
            let path = out.join(format!("{picture}.{ending}"));
            assert!(path.metadata().expect("a picture").len() > 1000, "{path:?}");
        }
    }
    assert_eq!(left_behind(pid), [""; 0]);

    // A second call with the same options drives nothing.
    let again = output(bench(ROWS, folder.path()));
    assert!(again.status.success(), "{again:?}");
    assert_eq!(json(&out.join("latency.json"))["rows"], measured["rows"]);

    // Rows of other settings are not overwritten.
    let mut longer = ROWS.to_vec();
    longer[6] = "3";
    let refused = output(bench(&longer, folder.path()));
    assert_eq!(refused.status.code(), Some(2), "{refused:?}");
    let told = String::from_utf8_lossy(&refused.stderr);
    assert!(told.contains("--seconds 2 in place of 3"), "{told}");
    assert_eq!(json(&out.join("latency.json"))["rows"], measured["rows"]);
}

#[test]
fn a_stopped_benchmark_keeps_its_finished_rows() {
    let folder = folder();
    let mut words = ROWS.to_vec();
    words[6] = "4";
    let mut child = bench(&words, folder.path());
    let first = folder.path().join("out/rows/100-hz-none-ordinary.json");
    until("the first row", || {
        let ended = child.try_wait().expect("its state");
        assert!(ended.is_none(), "it ended before the first row: {ended:?}");
        first.exists()
    });
    interrupt(&child);
    let pid = child.id();
    let done = output(child);
    assert_eq!(done.status.code(), Some(1), "{done:?}");
    let told = String::from_utf8_lossy(&done.stderr);
    assert!(told.contains("1 rows are left"), "{told}");
    let second = folder.path().join("out/rows/100-hz-cpu-ordinary.json");
    assert!(first.exists() && !second.exists());
    assert_eq!(left_behind(pid), [""; 0]);
}

#[test]
fn ctrl_c_reaches_set_and_load_through_the_benchmark_alone() {
    let folder = folder();
    let mut words = ROWS.to_vec();
    let chosen = [(2, "cpu"), (6, "60"), (10, "auto"), (12, "auto")];
    for (place, word) in chosen {
        words[place] = word;
    }
    let child = bench(&words, folder.path());
    let pid = child.id();
    until("the load and its witnesses", || has_thread(pid, "stalls-"));
    interrupt(&child);
    let done = output(child);
    assert_eq!(done.status.code(), Some(1), "{done:?}");
    let told = String::from_utf8_lossy(&done.stderr);
    assert!(told.contains("error: stopped, 1 rows are left"), "{told}");
    assert!(!told.contains("second signal"), "{told}");
    assert!(done.stdout.is_empty(), "no row, no table: {done:?}");
    assert_eq!(left_behind(pid), [""; 0]);
}

#[test]
fn a_killed_benchmark_takes_its_load_and_its_floor_with_it() {
    let folder = folder();
    let mut words = ROWS.to_vec();
    let chosen = [(2, "cpu"), (6, "60"), (10, "auto"), (12, "auto")];
    for (place, word) in chosen {
        words[place] = word;
    }
    let mut child = bench(&words, folder.path());
    let pid = child.id();
    // The floor is started last.
    until("all that runs beside the set", || has_thread(pid, "floor"));
    let children = children(pid);
    assert!(!children.is_empty(), "the set at least");
    child.kill().expect("a signal");
    child.wait().expect("its end");
    let ended = |pid: &&u32| !Path::new(&format!("/proc/{pid}/exe")).exists();
    until("the end of every process that it started", || {
        children.iter().filter(ended).count() == children.len()
    });
    let files = fs::read_dir(folder.path().join("out")).expect("--out");
    assert_eq!(files.count(), 1, "rows, and nothing of the load");
    // No process is left that could remove them.
    let run = format!("latency-0-{pid}").parse().expect("a run's name");
    bench::driven::remove(&RunPaths::new(run));
    assert_eq!(left_behind(pid), [""; 0]);
}

/// The living processes that the main thread of a process has started.
fn children(pid: u32) -> Vec<u32> {
    let list = fs::read_to_string(format!("/proc/{pid}/task/{pid}/children"));
    let list = list.unwrap_or_default();
    list.split_whitespace()
        .map(|pid| pid.parse().expect("a process id"))
        .collect()
}

fn has_thread(pid: u32, name: &str) -> bool {
    let threads = fs::read_dir(format!("/proc/{pid}/task"));
    let mut threads = threads.into_iter().flatten().flatten();
    threads.any(|thread| {
        let word = fs::read_to_string(thread.path().join("comm"));
        word.is_ok_and(|word| word.starts_with(name))
    })
}

#[test]
fn a_comparison_of_the_wire_that_is_stopped_prints_the_rows_it_has() {
    let folder = folder();
    let words = "ipc --message command,step --wake bell --rate 1000 --seconds 0.5";
    let words: Vec<&str> = words.split(' ').collect();
    let mut child = bench(&words, folder.path());
    let pid = child.id();
    let errors = child.stderr.take().expect("a pipe");
    let mut lines = BufReader::new(errors).lines().map_while(Result::ok);
    let first = lines.find(|line| line.starts_with("ipc: 1 of 2 rows"));
    assert!(first.is_some(), "it ended before its first row");
    interrupt(&child);
    let told: Vec<String> = lines.collect();
    let done = output(child);
    assert_eq!(done.status.code(), Some(1), "{told:?}");
    assert_eq!(told, ["error: stopped, 1 rows are left"]);
    let table = String::from_utf8_lossy(&done.stdout);
    assert!(
        table.contains("command 56 B") && !table.contains("step"),
        "{table}"
    );
    assert_eq!(left_behind(pid), [""; 0]);
}

#[test]
fn a_stopped_soak_judges_the_samples_it_has_and_leaves_nothing() {
    let folder = folder();
    let words = "soak --ticks 1000000 --samples 2000 --out out";
    let words: Vec<&str> = words.split(' ').collect();
    let child = bench(&words, folder.path());
    let pid = child.id();
    let samples = folder.path().join("out/samples.csv");
    let lines = || fs::read_to_string(&samples).map_or(0, |text| text.lines().count());
    until("a sample", || lines() > 1);
    interrupt(&child);
    let done = output(child);
    let told = String::from_utf8_lossy(&done.stderr);
    assert_eq!(done.status.code(), Some(1), "{told}");
    assert!(told.contains("error: stopped after"), "{told}");
    assert!(told.contains("of 1000000 ticks"), "{told}");
    assert_eq!(left_behind(pid), [""; 0]);
}

#[test]
fn a_message_goes_back_and_forth_over_every_side() {
    let folder = folder();
    let child = bench(
        &[
            "ipc",
            "--message",
            "step,command",
            "--rate",
            "0,100",
            "--wake",
            "bell,grid",
            "--seconds",
            "0.2",
            "--json",
            "ipc.json",
        ],
        folder.path(),
    );
    let pid = child.id();
    let done = output(child);
    assert!(done.status.success(), "{done:?}");
    let measured = json(&folder.path().join("ipc.json"));
    let rows = measured["rows"].as_array().expect("rows");
    // A row at full speed on a grid is invalid.
    assert_eq!(rows.len(), 2 * 3);
    for row in rows {
        let sides = row["sides"].as_array().expect("sides");
        assert_eq!(sides.len(), 4, "{row}");
        for side in sides {
            let of = |key: &str| side[key].as_u64().expect("a number");
            assert!(of("count") >= 10, "{row}");
            assert!(of("p50_ns") > 0 && of("p50_ns") <= of("max_ns"), "{row}");
        }
        assert!(row["ratio"].as_f64() > Some(0.0), "{row}");
    }
    assert_eq!(left_behind(pid), [""; 0]);
}
