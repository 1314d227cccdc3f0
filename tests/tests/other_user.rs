//! Another user of the machine can neither stop, change nor read a run.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

use rustix::process::{Pid, Signal, kill_process};
use vlaps_tests::two_users::{OTHER, Stage, VICTIM, text};
use vlaps_tests::{pids_within, programs, skip_unless, until};

/// Asserts the exit code and all these parts of the output.
fn assert_said(output: &Output, code: i32, parts: &[&str]) {
    let said = text(output);
    assert_eq!(output.status.code(), Some(code), "{said}");
    for part in parts {
        assert!(said.contains(part), "'{part}' is missing in: {said}");
    }
}

/// The mode bits, such as 0o755.
fn mode(path: &Path) -> u32 {
    let found = fs::metadata(path).expect("it is there");
    found.permissions().mode() & 0o7777
}

#[test]
fn a_folder_of_another_user_takes_no_run() {
    let Some(stage) = Stage::set("a run's folder of another user") else {
        return;
    };
    let here = stage.folder(VICTIM, "victim");
    let trap = stage.folder(OTHER, "trap");
    let up = |folder: &Path, parts: &[&str]| {
        let setting = format!("run.folder={}", folder.display());
        let words = ["up", "--lockstep", "--duration", "1", "--gate", "expert"];
        let output = stage.vlaps(VICTIM, &here, &[&words[..], &["--set", &setting]].concat());
        assert_said(&output, 2, parts);
        assert!(!folder.join("logs/gate.log").exists());
    };
    let trap = trap.display();
    // The other user's folder is open to all, so that only its owner is a reason to
    // refuse it.
    stage.sh(
        OTHER,
        &format!("mkdir -p -m 777 {trap}/r/logs; chmod 777 {trap}/r {trap}"),
    );
    let folder = format!("{trap}/r");
    let owner = format!("belongs to user {OTHER}");
    up(Path::new(&folder), &[&folder, &owner, "run.folder=DIR"]);
    // The user's own folder, to which others may write.
    stage.sh(VICTIM, &format!("mkdir -m 777 {}/open", here.display()));
    let open = here.join("open");
    up(&open, &["open to other users", "chmod go-w"]);
    // The user's own folder in a place where others may replace it by another.
    stage.sh(VICTIM, &format!("mkdir -m 755 {trap}/own"));
    let own = format!("{trap}/own");
    up(
        Path::new(&own),
        &["every user may rename", &trap.to_string()],
    );
    // Its own folder with another place for the logs.
    let script = format!(
        "cd {} && mkdir linked && ln -s {trap}/r/logs linked/logs",
        here.display()
    );
    stage.sh(VICTIM, &script);
    up(&here.join("linked"), &["linked/logs", "symbolic link"]);
}

#[test]
fn files_of_another_user_beside_a_run_are_left_alone() {
    let Some(stage) = Stage::set("another user's files beside a run's") else {
        return;
    };
    let here = stage.folder(VICTIM, "victim");
    let set = stage.drive(VICTIM, &here, "b");
    stage.sh(
        OTHER,
        ": > /dev/shm/vlaps-4242-b.x; mkfifo -m 666 /dev/shm/vlaps-4242-b.y",
    );
    // A restart joins the run, which closes its shared memory to others.
    let log = || fs::read_to_string(here.join("runs/b/logs/supervisor.log")).unwrap_or_default();
    for pid in pids_within(&here, "vlaps-planner") {
        let pid = Pid::from_raw(pid).expect("a process id");
        kill_process(pid, Signal::KILL).expect("killed");
    }
    until("the planner is ready again", || {
        log().matches("planner: ready").count() == 2
    });
    let told = [
        "/dev/shm/vlaps-4242-b.x: belongs to user 4243",
        "left alone",
    ];
    let vlaps = |words: &[&str]| stage.vlaps(VICTIM, &here, words);
    assert_said(&vlaps(&["status"]), 0, &told);
    assert_said(&vlaps(&["down"]), 0, &["run 'b' is stopped"]);
    assert_eq!(set.wait(), Some(0), "{}", log());
    let words = [
        "up",
        "--run",
        "b",
        "--lockstep",
        "--duration",
        "1",
        "--gate",
        "expert",
    ];
    let output = vlaps(&words);
    assert_said(&output, 0, &told);
    assert_eq!(
        text(&output).matches("b.x: belongs").count(),
        1,
        "said once"
    );
    assert_said(&vlaps(&["clean"]), 0, &["nothing to remove"]);
    let left = stage.sh(OTHER, "ls /dev/shm");
    assert_eq!(left, "vlaps-4242-b.x\nvlaps-4242-b.y\n");
}

#[test]
fn a_link_among_shared_memory_changes_no_file() {
    let Some(stage) = Stage::set("another user's link among shared memory") else {
        return;
    };
    let here = stage.folder(VICTIM, "victim");
    let precious = here.join("precious");
    stage.sh(
        VICTIM,
        &format!(
            "cd {} && echo kept > precious && chmod 755 precious",
            here.display()
        ),
    );
    let link = format!("ln -s {} /dev/shm/vlaps-4242-a.evil", precious.display());
    stage.sh(OTHER, &link);
    let _set = stage.drive(VICTIM, &here, "a");
    let vlaps = |words: &[&str]| stage.vlaps(VICTIM, &here, words);
    let told = "/dev/shm/vlaps-4242-a.evil: belongs to user 4243";
    assert_said(&vlaps(&["status", "--run", "a"]), 0, &[told]);
    assert_said(&vlaps(&["down"]), 0, &["run 'a' is stopped"]);
    assert_said(&vlaps(&["clean"]), 0, &["nothing to remove"]);
    assert_eq!(mode(&precious), 0o755, "the link was followed");
    assert_eq!(fs::read_to_string(&precious).expect("there"), "kept\n");
}

#[test]
fn a_folder_of_runs_that_is_another_users_is_refused_and_nothing_hangs() {
    let Some(stage) = Stage::set("another user's folder of runs") else {
        return;
    };
    // Root may enter every folder: only the check of the owner keeps it out.
    let here = stage.folder(0, "root");
    fs::write(here.join("policy.onnx"), "any").expect("written");
    stage.sh(
        OTHER,
        "mkdir -m 700 /dev/shm/vlaps-0 /dev/shm/vlaps-0/evil; mkfifo /dev/shm/vlaps-0/evil/supervisor",
    );
    let refused = [
        "/dev/shm/vlaps-0",
        "belongs to user 4243 with mode 700",
        "not safe to use",
    ];
    for words in [
        &["down"][..],
        &["down", "--run", "evil"],
        &["status"],
        &["status", "--run", "evil"],
        &["swap", "policy.onnx"],
        &["swap", "policy.onnx", "--run", "evil"],
        &["clean"],
        &["up", "--run", "evil", "--lockstep", "--duration", "1"],
    ] {
        assert_said(&stage.vlaps(0, &here, words), 1, &refused);
    }
    assert_eq!(stage.sh(OTHER, "ls /dev/shm/vlaps-0/evil"), "supervisor\n");
}

/// A program takes the lock of a run's supervisor for its parent and ends; the next
/// process gets its id. `$1` is the program to test, `$2` a folder to work in. The
/// lines are what `down` says of two such processes, and that they live.
const REUSED: &str = r#"
mount -t tmpfs -o mode=1777 tmpfs /dev/shm || exit 3
cd "$2" || exit 3
cp "$(command -v sleep)" "$2/vlaps-supervisor" || exit 3
mkdir -m 700 /dev/shm/vlaps-0 /dev/shm/vlaps-0/evil
exec 9> /dev/shm/vlaps-0/evil/supervisor
for program in sleep "$2/vlaps-supervisor"; do
    flock -u 9
    sh -c 'echo $$ > pid; exec flock -x 9'
    read -r pid < pid
    # As the supervisor that had this id left it.
    echo "$pid 1" > /dev/shm/vlaps-0/evil/supervisor
    for _ in 1 2 3 4 5 6 7 8 9; do
        echo $((pid - 1)) > /proc/sys/kernel/ns_last_pid
        "$program" 1000 9>&- &
        got=$!
        [ "$got" = "$pid" ] && break
        kill "$got"
    done
    [ "$got" = "$pid" ] || exit 4
    # Until then it is still bash.
    until [ "/proc/$pid/exe" -ef "$(command -v "$program")" ]; do
        kill -0 "$pid" || exit 5
        sleep 0.01
    done
    "$1" down --run evil 9>&- 2>&1
    echo "code $?"
    kill -0 "$pid" && echo alive
    kill "$pid"
    wait "$pid"
done
"#;

#[test]
fn a_process_id_that_another_program_has_now_gets_no_signal() {
    let what = "a reused process id";
    let probe = "echo 100 > /proc/sys/kernel/ns_last_pid && mount -t tmpfs tmpfs /dev/shm";
    let namespace = [
        "unshare",
        "-m",
        "-p",
        "--fork",
        "--mount-proc",
        "--kill-child",
    ];
    let why = format!("{what}: needs root, unshare and /proc/sys/kernel/ns_last_pid");
    if skip_unless(&[&namespace[..], &["sh", "-c", probe]].concat(), &why) {
        return;
    }
    let folder = std::env::temp_dir().join(format!("vlaps-reused-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("a folder");
    let output = Command::new("timeout")
        .args(["--signal=KILL", "60"])
        .args(namespace)
        .args(["bash", "-c", REUSED, "bash"])
        .arg(programs().join("vlaps-supervisor"))
        .arg(&folder)
        .output()
        .expect("unshare");
    let _ = fs::remove_dir_all(&folder);
    let said = text(&output);
    let lives = said.lines().filter(|line| *line == "alive").count();
    let refused = said.lines().filter(|line| *line == "code 1").count();
    assert_eq!((lives, refused), (2, 2), "{said}");
    assert!(said.contains("is not its supervisor (it runs "), "{said}");
    assert!(said.contains("was started after the supervisor"), "{said}");
}

#[test]
fn another_user_reads_nothing_of_a_run() {
    let Some(stage) = Stage::set("a run's privacy") else {
        return;
    };
    let here = stage.folder(VICTIM, "victim");
    let set = stage.drive(VICTIM, &here, "p");
    let files = stage.sh(VICTIM, "ls /dev/shm/vlaps-4242-p.* /dev/shm/vlaps-4242/p/*");
    assert!(files.lines().count() > 20, "{files}");
    let try_all = "for file in /dev/shm/vlaps-4242-p.*; do \
        cat $file > /dev/null 2>&1 && echo read $file; \
        (: >> $file) 2> /dev/null && echo wrote $file; done; \
        ls /dev/shm/vlaps-4242 2> /dev/null && echo listed; \
        cat /dev/shm/vlaps-4242/p/config.toml 2> /dev/null && echo read; \
        ls /dev/shm/vlaps-4242/p 2> /dev/null && echo entered; true";
    assert_eq!(stage.sh(OTHER, try_all), "");
    // Not even by the name of its run.
    let elsewhere = stage.folder(OTHER, "other");
    let status = stage.vlaps(OTHER, &elsewhere, &["status", "--run", "p"]);
    assert_said(&status, 1, &["run 'p' is not running"]);
    assert_said(&stage.vlaps(VICTIM, &here, &["down"]), 0, &["stopped"]);
    assert_eq!(set.wait(), Some(0));
}
