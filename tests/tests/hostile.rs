//! Machines that refuse: shared memory that is full, and no real-time privileges.

use std::process::Output;

use vlaps_tests::{Set, skip_unless};

const NAMESPACES: &str = "this machine grants no user and mount namespaces (unshare -rm)";

fn text(output: &Output) -> String {
    format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    )
}

#[test]
fn a_full_shared_memory_ends_in_one_clear_line() {
    if skip_unless(
        &[
            "unshare", "-rm", "mount", "-t", "tmpfs", "tmpfs", "/dev/shm",
        ],
        NAMESPACES,
    ) {
        return;
    }
    let set = Set::new("full");
    let mount = "mount -t tmpfs -o size=2m tmpfs /dev/shm && exec \"$0\" \"$@\"";
    let wrapper = ["unshare", "-rm", "sh", "-c", mount];
    let output = set
        .up_command(&wrapper, &["--lockstep", "--seed", "3", "--duration", "5"])
        .output()
        .expect("unshare");
    let said = text(&output);
    assert!(!output.status.success(), "{said}");
    let errors: Vec<_> = said
        .lines()
        .filter(|line| line.contains("/dev/shm"))
        .collect();
    assert_eq!(errors.len(), 1, "{said}");
    assert!(
        errors[0].contains("clean") || errors[0].contains("remount"),
        "{said}"
    );
}

#[test]
fn without_the_real_time_right_it_warns_once_and_drives() {
    if skip_unless(&["unshare", "-rm", "true"], NAMESPACES) {
        return;
    }
    let set = Set::new("norights");
    // In its own user namespace, root has no right to real-time priority outside.
    let output = set
        .up_command(&["unshare", "-r"], &["--seed", "3", "--duration", "2"])
        .output()
        .expect("unshare");
    let said = text(&output);
    assert!(output.status.success(), "{said}\n{}", set.logs());
    let warnings = said.lines().filter(|line| line.contains("doctor")).count();
    assert_eq!(warnings, 1, "{said}");
    let json = set.json();
    for process in ["world", "planner", "controller"] {
        let realtime = &json["processes"][process]["realtime"];
        assert_eq!(realtime["priority"], "refused", "{json}");
        assert_eq!(realtime["priority_got"], 0);
    }
    assert_eq!(json["ticks"], 20);
}
