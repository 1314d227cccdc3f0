//! API keys, kept out of all processes that do not need them.
//!
//! A key arrives in an environment variable. The kernel shows the environment in
//! `/proc/PID/environ`, passes it to every child and writes it to core files. So each
//! program removes its keys at the start of `main`: the values go into a sealed file in
//! memory that has no name and is not mapped, and the bytes in the environment are
//! overwritten. The supervisor passes that file to the gate alone, as its standard
//! input; no other process inherits it.
//!
//! This does not hide a key from a debugger of the same user, or from root.

use std::ffi::{CString, OsStr};
use std::fs::File;
use std::io::{self, Write as _};
use std::os::fd::AsFd;
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::fs::FileExt as _;
use std::process::{Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};

use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, fcntl_get_seals, memfd_create};
use rustix::process::{DumpableBehavior, Resource, Rlimit, set_dumpable_behavior, setrlimit};
use zeroize::{Zeroize as _, Zeroizing};

/// The variables that hold keys unless the configuration names another.
pub const VARIABLES: [&str; 2] = ["VLAPS_VLM_KEY", "OPENAI_API_KEY"];

/// Most bytes of a value that are kept. A key has about 200, and a longer value than
/// this is not a key.
const VALUE_BYTES_MAX: usize = 64 << 10;

/// Largest file, bytes: the variables above, one from the configuration, and as much
/// again.
const FILE_BYTES_MAX: usize = 8 * VALUE_BYTES_MAX;

/// The first bytes of the file, so that other data on standard input is not mistaken
/// for it.
const HEADER: &[u8] = b"vlaps secrets 1\0";

/// The removed variables, `NAME=value`, each closed by a zero byte, after the header.
/// The file is sealed against every change, so its readers need not trust each other.
static TAKEN: Mutex<Option<File>> = Mutex::new(None);

fn taken() -> MutexGuard<'static, Option<File>> {
    // After a panic the file is there or not; both are valid.
    TAKEN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes the keys from the environment and from standard input. Call it at the start
/// of `main`, before there is a second thread.
///
/// # Errors
/// When a key is in the environment and cannot be taken out of it.
pub fn take() -> io::Result<()> {
    take_all(&VARIABLES)?;
    if taken().is_none()
        && let Some(lent) = lent_to_us()
    {
        *taken() = Some(lent);
    }
    Ok(())
}

/// Removes one more variable from the environment, such as the one that `vlm.key_env`
/// names.
///
/// # Errors
/// When it is set and cannot be removed, as in a process with several threads.
pub fn take_named(name: &str) -> io::Result<()> {
    match name.is_empty() {
        true => Ok(()),
        false => take_all(&[name]),
    }
}

fn take_all(names: &[&str]) -> io::Result<()> {
    let mut file = None;
    for name in names {
        let variable = CString::new(*name)?;
        let mut keep = |value: &[u8]| {
            let mut file: &File = match &mut file {
                Some(file) => file,
                none => none.insert(empty_file()?),
            };
            file.write_all(name.as_bytes())?;
            file.write_all(b"=")?;
            file.write_all(&value[..value.len().min(VALUE_BYTES_MAX + 1)])?;
            file.write_all(b"\0")
        };
        while take_entry(&variable, &mut keep)? {}
    }
    let Some(mut file) = file else { return Ok(()) };
    let mut taken = taken();
    if let Some(before) = taken.as_ref() {
        file.write_all(&content(before)?[HEADER.len()..])?;
    }
    fcntl_add_seals(&file, all_seals())?;
    *taken = Some(file);
    Ok(())
}

fn empty_file() -> io::Result<File> {
    let flags = MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING;
    let mut file = File::from(memfd_create("vlaps-secrets", flags)?);
    file.write_all(HEADER)?;
    Ok(file)
}

fn all_seals() -> SealFlags {
    SealFlags::SEAL | SealFlags::SHRINK | SealFlags::GROW | SealFlags::WRITE
}

/// Passes the value of one entry of the environment to `keep` and overwrites the entry
/// with its name; `false` when there is none. The value is copied nowhere else.
#[allow(unsafe_code)]
fn take_entry(name: &CString, keep: &mut dyn FnMut(&[u8]) -> io::Result<()>) -> io::Result<bool> {
    // SAFETY: `name` is a string of C. A caller that changes the environment in Rust has
    // promised that no other thread reads it meanwhile.
    let value = unsafe { libc::getenv(name.as_ptr()) };
    if value.is_null() {
        return Ok(false);
    }
    if std::fs::read_dir("/proc/self/task")?.count() != 1 {
        return Err(io::Error::other("other threads may read the environment"));
    }
    let before = name.as_bytes().len() + 1;
    // SAFETY: `getenv` points behind the `=` of an entry `NAME=value\0`, which is
    // writable memory of this process for as long as it lives. The count above says
    // that this is the only thread, so nothing reads the entry while it changes, and
    // the slice does not leave this function.
    let entry = unsafe {
        let length = before + libc::strlen(value);
        std::slice::from_raw_parts_mut(value.sub(before).cast::<u8>(), length)
    };
    let kept = keep(&entry[before..]);
    // An entry without a name is none; those of the same name are found next.
    entry.zeroize();
    kept.map(|()| true)
}

/// The file that the parent passed as standard input, if it is one of [`lend`].
fn lent_to_us() -> Option<File> {
    let input = io::stdin();
    // Other inputs, such as a terminal or a pipe, are not read: the data would be
    // missing from the process for which it is meant.
    let seals = fcntl_get_seals(input.as_fd()).ok()?;
    if !seals.contains(all_seals()) {
        return None;
    }
    let file = File::from(input.as_fd().try_clone_to_owned().ok()?);
    content(&file).ok()?.starts_with(HEADER).then_some(file)
}

/// Reads at an offset, because all processes that received the file share one position
/// in it.
fn content(file: &File) -> io::Result<Zeroizing<Vec<u8>>> {
    let length = usize::try_from(file.metadata()?.len()).unwrap_or(usize::MAX);
    if length > FILE_BYTES_MAX {
        return Err(io::Error::other("too many secrets"));
    }
    let mut content = Zeroizing::new(vec![0; length]);
    file.read_exact_at(&mut content, 0)?;
    Ok(content)
}

fn entries(content: &[u8]) -> impl Iterator<Item = (&[u8], &[u8])> {
    let entries = content.get(HEADER.len()..).unwrap_or_default();
    entries.split(|byte| *byte == 0).filter_map(|entry| {
        let at = entry.iter().position(|byte| *byte == b'=')?;
        Some((&entry[..at], &entry[at + 1..]))
    })
}

/// The value of a removed variable; `None` when it was not set or is not text. The
/// caller overwrites it after use.
pub fn value(name: &str) -> Option<String> {
    let content = content(taken().as_ref()?).ok()?;
    let found = entries(&content).find(|(known, _)| *known == name.as_bytes());
    found.and_then(|(_, value)| Some(str::from_utf8(value).ok()?.to_owned()))
}

/// The removed variables as the standard input of a child that may use them: the gate,
/// or a supervisor. Without any, an empty input.
///
/// # Errors
/// When the process has no file descriptor left.
pub fn lend() -> io::Result<Stdio> {
    Ok(match taken().as_ref() {
        Some(file) => file.try_clone()?.into(),
        None => Stdio::null(),
    })
}

/// Removes the known variables from a child's environment.
pub fn withhold(command: &mut Command) {
    for name in VARIABLES {
        command.env_remove(name);
    }
}

/// Puts the removed variables into the environment of a program that is executed in
/// place of this one and keeps the user's standard input. That program removes them
/// again.
pub fn hand_on(command: &mut Command) {
    let content = taken().as_ref().and_then(|file| content(file).ok());
    let content = content.unwrap_or_default();
    for (name, value) in entries(&content) {
        command.env(OsStr::from_bytes(name), OsStr::from_bytes(value));
    }
}

/// Protects this process's memory from core files and from other processes of the user,
/// because it holds a key. Children do not inherit all of this.
///
/// # Errors
/// When the kernel refuses.
pub fn forbid_dumps() -> io::Result<()> {
    let none = Rlimit {
        current: Some(0),
        maximum: Some(0),
    };
    setrlimit(Resource::Core, none)?;
    Ok(set_dumpable_behavior(DumpableBehavior::NotDumpable)?)
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn what_is_written_is_read_by_its_name() {
        let content = b"vlaps secrets 1\0A=first\0B=with=sign\0EMPTY=\0A=second\0";
        let found: Vec<_> = entries(content).collect();
        let word = |text: &'static str| text.as_bytes();
        assert_eq!(found[0], (word("A"), word("first")));
        assert_eq!(found[1], (word("B"), word("with=sign")));
        assert_eq!(found[2], (word("EMPTY"), word("")));
        assert_eq!(found.len(), 4);
        assert_eq!(entries(b"").count(), 0);
    }

    #[test]
    fn beside_another_thread_the_environment_stays_as_it_is() {
        let (stop, stopped) = channel::<()>();
        let other = std::thread::spawn(move || stopped.recv());
        let before = std::env::var_os("PATH");
        let error = take_named("PATH").expect_err("two threads");
        assert!(error.to_string().contains("threads"), "{error}");
        assert!(before.is_some() && std::env::var_os("PATH") == before);
        assert!(
            take_named("VLAPS_NEVER_SET").is_ok(),
            "nothing to overwrite"
        );
        drop(stop);
        let _ = other.join();
    }
}
