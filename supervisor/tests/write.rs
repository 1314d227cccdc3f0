//! Where results are written: a link is followed, a device is never replaced.

use std::fs;
use std::os::unix::fs::{FileTypeExt, symlink};
use std::path::Path;

use supervisor::summary::write_whole;

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
    let reader = {
        let pipe = pipe.clone();
        std::thread::spawn(move || fs::read_to_string(pipe).expect("read"))
    };
    write_whole(&pipe, "through").expect("written");
    assert_eq!(reader.join().expect("a reader"), "through");
    let kind = fs::symlink_metadata(&pipe).expect("the pipe").file_type();
    assert!(kind.is_fifo(), "still a pipe");
    assert!(write_whole(Path::new("/no/such/folder/a"), "x").is_err());
}
