//! Tests of output files: a link is followed, a device is never replaced.

use std::fs;
use std::io::Read;
use std::os::unix::fs::{FileTypeExt, symlink};
use std::path::Path;

use rustix::fs::{Mode, OFlags};
use supervisor::cli::output::write_whole;

#[test]
fn a_link_stays_a_link_and_its_target_is_written() {
    let dir = tempfile::tempdir().expect("a folder");
    let (target, link) = (dir.path().join("target.json"), dir.path().join("link.json"));
    fs::write(&target, "old").expect("written");
    symlink(&target, &link).expect("a link");
    write_whole(&link, "new").expect("written");
    assert!(fs::symlink_metadata(&link).expect("the link").is_symlink());
    assert_eq!(fs::read_to_string(&target).expect("the target"), "new");
    assert_eq!(fs::read_dir(dir.path()).expect("the folder").count(), 2);
}

#[test]
fn a_pipe_is_written_to_and_not_replaced() {
    let dir = tempfile::tempdir().expect("a folder");
    let pipe = dir.path().join("pipe");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    assert!(made.is_ok_and(|status| status.success()));
    let error = write_whole(&pipe, "lost").expect_err("it has no reader");
    assert!(error.to_string().contains("nothing reads"), "{error}");
    // More than a pipe holds: the writer waits for its reader.
    let text = "through".repeat(100_000);
    let flags = OFlags::RDONLY | OFlags::NONBLOCK;
    let reader = rustix::fs::open(&pipe, flags, Mode::empty()).expect("a reader");
    rustix::fs::fcntl_setfl(&reader, OFlags::empty()).expect("it waits for text");
    let reader = std::thread::spawn(|| {
        let mut read = String::new();
        fs::File::from(reader)
            .read_to_string(&mut read)
            .expect("read");
        read
    });
    write_whole(&pipe, &text).expect("written");
    assert_eq!(reader.join().expect("a reader"), text);
    let kind = fs::symlink_metadata(&pipe).expect("the pipe").file_type();
    assert!(kind.is_fifo(), "still a pipe");
    assert!(write_whole(Path::new("/no/such/folder/a"), "x").is_err());
}
