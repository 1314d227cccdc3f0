//! Tests of logs and of the live table.

use std::fs;
use std::io::Write;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;

use runtime::LogFile;
use supervisor::show::view::View;
use supervisor::telemetry::tally::Tally;

use crate::common::Rig;

#[test]
fn a_full_log_is_set_aside_and_the_writer_goes_on() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let mut log = LogFile::create(dir.path(), "planner", 100).expect("a log");
    let mut writer = log.begin().expect("a handle");
    writeln!(writer, "short").expect("written");
    log.rotate().expect("looked at");
    assert!(!log.older().exists(), "not before it is full");
    writeln!(writer, "{}", "x".repeat(100)).expect("written");
    log.rotate().expect("rotated");
    writeln!(writer, "after").expect("written");
    assert_eq!(fs::read_to_string(log.path()).expect("read"), "after\n");
    let older = fs::read_to_string(log.older()).expect("read");
    assert!(older.starts_with("short\nxxx"), "{older}");
    assert_eq!(log.last_line().as_deref(), Some("after"));
}

#[test]
fn no_link_or_pipe_leads_a_log_elsewhere() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let victim = dir.path().join("victim");
    fs::write(&victim, "precious").expect("written");
    let logs = dir.path().join("logs");
    fs::create_dir(&logs).expect("a folder");
    let log_in = |logs: &Path| LogFile::create(logs, "gate", 10);
    let mut log = log_in(&logs).expect("a log");
    let mut writer = log.begin().expect("a handle");
    for name in ["gate.log.1", "gate.log.1.new"] {
        symlink(&victim, logs.join(name)).expect("a link");
    }
    // The name of the log itself is now a link to a device that never ends.
    fs::remove_file(log.path()).expect("removed");
    symlink(&victim, log.path()).expect("a link");
    writeln!(writer, "more than ten bytes").expect("written");
    log.rotate().expect("rotated");
    assert_eq!(log.last_line(), None, "cut by its own descriptor");
    let older = fs::read_to_string(log.older()).expect("read");
    assert_eq!(older, "more than ten bytes\n");
    let found = fs::symlink_metadata(log.older()).expect("there");
    assert!(found.is_file(), "the link was replaced");
    log.begin().expect("a handle");
    assert_eq!(fs::read_to_string(&victim).expect("read"), "precious");
    // A folder that others may write to, or that is a link, holds no log.
    let link = dir.path().join("link");
    symlink(&logs, &link).expect("a link");
    assert!(log_in(&link).is_err(), "followed");
    fs::set_permissions(&logs, fs::Permissions::from_mode(0o777)).expect("ours");
    let error = log_in(&logs).expect_err("others may write there");
    assert!(error.to_string().contains("chmod go-w"), "{error}");
}

#[test]
fn the_last_line_is_the_newest_processs_own() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let mut log = LogFile::create(dir.path(), "gate", 1000).expect("a log");
    assert_eq!(log.last_line(), None);
    let mut first = log.begin().expect("a handle");
    write!(first, "one\ntwo\x1b[31m \n\n").expect("written");
    assert_eq!(
        log.last_line().as_deref(),
        Some("two[31m"),
        "no control codes"
    );
    let _second = log.begin().expect("a handle");
    assert_eq!(
        log.last_line(),
        None,
        "the second process has written nothing"
    );
    // The next run renames the logs of this one.
    let next = LogFile::create(dir.path(), "gate", 1000).expect("a log");
    assert_eq!(fs::read_to_string(next.path()).expect("read"), "");
    assert!(next.older().exists());
}

#[test]
fn the_live_table_fits_a_terminal_of_80_columns() {
    let mut rig = Rig::new("idle", |_| ());
    rig.start_all();
    let mut view = View::from_inside(&rig.config, &Tally::default(), &rig.set);
    for row in &mut view.processes {
        row.pid = Some(4_194_304);
        row.ticks = 99_999_999;
    }
    for line in view.table().lines() {
        assert!(line.len() <= 80, "{} columns: {line}", line.len());
    }
    assert_eq!(view.table().lines().count(), 1 + rig.set.members().len());
}
