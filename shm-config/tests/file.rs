//! Files of the calling user are opened without following a link, and replaced as a
//! whole.

use std::fs;
use std::io;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};

use shm_config::file::{
    Access, Durable, Entry, Folder, NotOurs, check_parents, check_writable, open_ours, read,
    read_private, replace,
};

/// A folder of one test, which is removed when this is dropped.
struct Place(PathBuf);

impl Place {
    fn new(label: &str) -> Self {
        let path = std::env::temp_dir().join(format!("vlaps-file-{}-{label}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir(&path).unwrap();
        let place = Self(path);
        place.set_mode(".", 0o755);
        place
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    fn set_mode(&self, name: &str, mode: u32) {
        fs::set_permissions(self.at(name), fs::Permissions::from_mode(mode)).unwrap();
    }

    fn pipe(&self, name: &str) -> PathBuf {
        let path = self.at(name);
        let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
        rustix::fs::mknodat(rustix::fs::CWD, &path, rustix::fs::FileType::Fifo, mode, 0).unwrap();
        path
    }

    fn names(&self) -> Vec<String> {
        let entries = fs::read_dir(&self.0).unwrap();
        let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<_> = names.collect();
        names.sort();
        names
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn said<T>(result: io::Result<T>) -> String {
    match result {
        Ok(_) => "no error".into(),
        Err(error) => error.to_string(),
    }
}

#[test]
fn a_named_file_is_read_to_its_bound_and_a_pipe_is_not_waited_for() {
    let place = Place::new("read");
    fs::write(place.at("file"), "12345").unwrap();
    symlink("file", place.at("link")).unwrap();
    assert_eq!(read(&place.at("link"), 5).unwrap(), b"12345");
    assert!(said(read(&place.at("file"), 4)).contains("4 bytes"));
    for special in [place.pipe("pipe"), "/dev/zero".into(), place.0.clone()] {
        assert!(said(read(&special, 5)).contains("no regular file"));
    }
}

#[test]
fn a_private_file_is_its_users_alone() {
    let place = Place::new("private");
    fs::write(place.at("key"), "12345").unwrap();
    symlink("key", place.at("link")).unwrap();
    place.set_mode("key", 0o600);
    assert_eq!(read_private(&place.at("link"), 5).unwrap(), "12345");
    assert!(said(read_private(&place.at("key"), 4)).contains("4 bytes"));
    for mode in [0o640, 0o604, 0o620, 0o610] {
        place.set_mode("key", mode);
        let error = read_private(&place.at("key"), 5).unwrap_err();
        let open = NotOurs::within(&error).map(NotOurs::owner_and_mode);
        assert_eq!(open.map(|(_, mode)| mode), Some(mode), "{error}");
    }
    let pipe = place.pipe("pipe");
    assert!(said(read_private(&pipe, 5)).contains("no regular file"));
}

#[test]
fn a_file_of_ours_is_no_link_and_no_pipe() {
    let place = Place::new("ours");
    fs::write(place.at("file"), "old").unwrap();
    symlink("file", place.at("link")).unwrap();
    symlink("new", place.at("dangling")).unwrap();
    place.pipe("pipe");
    for access in [Access::Read, Access::Append, Access::Change, Access::New] {
        for name in ["link", "dangling", "pipe"] {
            assert!(
                open_ours(&place.at(name), access).is_err(),
                "{name} {access:?}"
            );
        }
    }
    assert!(!place.at("new").exists(), "the link was followed");
    assert!(said(open_ours(&place.at("link"), Access::Read)).contains("symbolic link"));
    // A file of root, if this user is not root; tests with two users cover root.
    if rustix::process::getuid().as_raw() != 0 {
        let error = open_ours(Path::new("/etc/passwd"), Access::Read).unwrap_err();
        assert!(NotOurs::within(&error).is_some(), "{error}");
    }
}

#[test]
fn a_file_is_replaced_as_a_whole_and_a_link_in_its_place_is_not_followed() {
    let place = Place::new("replace");
    fs::write(place.at("victim"), "precious").unwrap();
    symlink("victim", place.at("file")).unwrap();
    // The first temporary name is already taken by a link.
    let beside = format!("file.{}-0", std::process::id());
    symlink("victim", place.at(&beside)).unwrap();
    replace(&place.at("file"), b"new", Durable::Yes).unwrap();
    assert_eq!(fs::read(place.at("victim")).unwrap(), b"precious");
    assert!(fs::symlink_metadata(place.at("file")).unwrap().is_file());
    assert_eq!(fs::read(place.at("file")).unwrap(), b"new");
    check_writable(&place.0).unwrap();
    assert_eq!(place.names(), ["file", &beside, "victim"]);
    let nowhere = replace(&place.at("none/file"), b"new", Durable::No);
    assert_eq!(nowhere.unwrap_err().kind(), io::ErrorKind::NotFound);
}

#[test]
fn a_folder_of_ours_is_closed_to_others_and_stays_the_one_that_was_opened() {
    let place = Place::new("folder");
    let made = Folder::make(&place.at("a"), Entry::Readable).unwrap();
    place.set_mode("a", 0o755);
    assert!(said(Folder::open(&place.at("a"), Entry::Private)).contains("chmod go-rwx"));
    place.set_mode("a", 0o775);
    let error = Folder::open(&place.at("a"), Entry::Readable).unwrap_err();
    assert_eq!(NotOurs::within(&error).unwrap().owner_and_mode().1, 0o775);
    symlink("a", place.at("link")).unwrap();
    for path in ["link", "link/", "link/."] {
        let error = said(Folder::open(&place.at(path), Entry::Readable));
        assert!(error.contains("symbolic link"), "{path}: {error}");
    }
    // The folder is replaced by another one; writes still go to the opened one.
    fs::rename(place.at("a"), place.at("b")).unwrap();
    fs::create_dir(place.at("a")).unwrap();
    made.replace("file", b"text", Durable::No).unwrap();
    assert_eq!(fs::read(place.at("b/file")).unwrap(), b"text");
    assert!(!place.at("a/file").exists());
}

#[test]
fn a_folder_above_that_every_user_writes_to_is_found() {
    let place = Place::new("above");
    fs::create_dir_all(place.at("open/run")).unwrap();
    check_parents(&place.at("open/run")).unwrap();
    place.set_mode("open", 0o777);
    let error = said(check_parents(&place.at("open/run")));
    assert!(error.contains("open (mode 777)"), "{error}");
    place.set_mode("open", 0o1777);
    check_parents(&place.at("open/run")).unwrap();
}
