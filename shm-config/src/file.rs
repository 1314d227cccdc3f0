//! Files that a command line or a configuration names.

use std::fs::{self, Metadata};
use std::io;
use std::path::Path;

/// What the system says of a file that is about to be read. Asked before it is
/// opened: a pipe would wait for ever, a device has no end.
///
/// # Errors
/// When there is nothing at the path, or what is there is no regular file.
pub fn regular(path: &Path) -> io::Result<Metadata> {
    let metadata = fs::metadata(path)?;
    match metadata.is_file() {
        true => Ok(metadata),
        false => Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            "is no regular file",
        )),
    }
}
