//! The children of a set's processes end with their parent, and no other process does.

use std::fs;
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::{Path, PathBuf};
use std::process::Stdio;

use rustix::process::{Pid, Signal, kill_process};
use vlaps_tests::{Set, programs, until};

/// A folder of programs whose world is this script.
fn programs_with_world(set: &Set, script: &str) -> PathBuf {
    let folder = set.folder().join("programs");
    fs::create_dir_all(&folder).expect("a folder");
    for program in ["vlaps-planner", "vlaps-controller", "vlaps-gate"] {
        symlink(programs().join(program), folder.join(program)).expect("a link");
    }
    let world = folder.join("vlaps-world");
    fs::write(&world, script).expect("written");
    fs::set_permissions(&world, fs::Permissions::from_mode(0o755)).expect("set");
    folder
}

/// Process ids of `sleep SECONDS`. Each test has its own number.
fn sleeping(seconds: &str) -> Vec<i32> {
    let line = format!("sleep\0{seconds}\0");
    let entries = fs::read_dir("/proc").expect("/proc").flatten();
    let numbers = entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let is_it =
        |pid: &i32| fs::read(format!("/proc/{pid}/cmdline")).ok() == Some(line.clone().into());
    numbers.filter(is_it).collect()
}

fn seconds(label: u32) -> String {
    format!("{label}.{}", std::process::id())
}

fn log(set: &Set) -> String {
    let run = set.folder().join("runs").join(set.name().to_string());
    fs::read_to_string(run.join("logs/supervisor.log")).unwrap_or_default()
}

#[test]
fn children_of_a_world_that_dies_end_and_the_run_can_be_driven_again() {
    let set = Set::new("dies");
    let (nap, foreign) = (seconds(1001), seconds(1002));
    // They hold the run's lock, have their own sessions, and some have already lost
    // their parent.
    let script = format!(
        "#!/bin/sh\n\
         exec 9< \"$(dirname \"$2\")/alive\"\n\
         flock -s 9\n\
         for k in 1 2 3; do setsid sleep {nap} & done\n\
         setsid sh -c 'setsid sleep {nap} & setsid sleep {nap} &'\n\
         setsid sh -c 'sleep {nap}; exit' &\n\
         until [ $(pgrep -fxc 'sleep {nap}') -ge 6 ]; do sleep 0.01; done\n\
         exit 3\n"
    );
    let folder = programs_with_world(&set, &script);
    // A shell may have started a process before it executed the supervisor.
    let before = format!("sleep {foreign} >/dev/null 2>&1 & exec \"$0\" \"$@\"");
    let output = set
        .up_command(
            &["sh", "-c", &before],
            &["--lockstep", "--set", "supervisor.restarts_max=2"],
        )
        .env("VLAPS_BIN_DIR", &folder)
        .output()
        .expect("the supervisor starts");
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let lived = sleeping(&foreign);
    for pid in lived.iter().filter_map(|pid| Pid::from_raw(*pid)) {
        let _ = kill_process(pid, Signal::KILL);
    }
    assert_eq!(
        lived.len(),
        1,
        "a process that does not belong to the run is not ended"
    );
    assert_eq!(sleeping(&nap), Vec::<i32>::new(), "{}", log(&set));
    let told = log(&set);
    let lines = told
        .lines()
        .filter(|line| line.contains("world: 7 left-over child processes ended"));
    assert_eq!(lines.count(), 3, "once for each death: {told}");

    let output = set.run(&["--lockstep", "--seed", "3", "--duration", "2"]);
    assert!(output.status.success(), "{output:?}");
}

#[test]
fn children_of_a_living_world_live_while_others_die_and_end_with_the_set() {
    let mut set = Set::new("lives");
    let nap = seconds(1003);
    let seen = set.folder().join("environment");
    let script = format!(
        "#!/bin/sh\n\
         tr '\\0' '\\n' < /proc/self/environ > {}\n\
         setsid sh -c 'setsid sleep {nap} & sleep 0.1 &'\n\
         exec {} \"$@\"\n",
        seen.display(),
        programs().join("vlaps-world").display()
    );
    let folder = programs_with_world(&set, &script);
    let mut command = set.up_command(&[], &["--seed", "3", "--gate", "rules"]);
    command
        .env("VLAPS_BIN_DIR", &folder)
        .env("VLAPS_VLM_KEY", "sk-test-not-for-worlds")
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    set.start_as(&mut command);
    until("the world drives", || log(&set).contains("world: ready"));
    until("its child sleeps", || sleeping(&nap).len() == 1);
    let text = fs::read_to_string(&seen).expect("the world's environment");
    assert!(text.contains("VLAPS_CHILD_OF="), "{text}");
    assert!(!text.contains("sk-test"), "a world gets no key: {text}");

    let planner = set.pids("vlaps-planner");
    set.signal_program("vlaps-planner", Signal::KILL);
    until("another planner", || {
        let now = set.pids("vlaps-planner");
        !now.is_empty() && now != planner
    });
    assert_eq!(sleeping(&nap).len(), 1, "its world lives");
    assert!(!log(&set).contains("left-over"), "{}", log(&set));
    let supervisor = set.pids("vlaps-supervisor");
    until("dead children that were left over are collected", || {
        dead_children(supervisor[0]).is_empty()
    });

    set.signal(Signal::TERM);
    assert_eq!(set.wait(), Some(0), "{}", set.logs());
    assert_eq!(sleeping(&nap), Vec::<i32>::new());
    assert!(
        log(&set).contains("world: 1 left-over child process ended"),
        "{}",
        log(&set)
    );
}

/// Children of a process that have ended and were not reaped.
fn dead_children(parent: i32) -> Vec<PathBuf> {
    let entries = fs::read_dir("/proc").expect("/proc").flatten();
    let is_dead = |path: &Path| {
        let stat = fs::read_to_string(path.join("stat")).unwrap_or_default();
        let rest = stat.rsplit(')').next().unwrap_or_default();
        rest.starts_with(&format!(" Z {parent} "))
    };
    let paths = entries.map(|entry| entry.path());
    paths.filter(|path| is_dead(path)).collect()
}
