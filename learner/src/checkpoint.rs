//! The state of a learner on disk; the file is replaced as a whole or not at all.

use std::io;
use std::path::Path;

use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};
use shm_config::file::{Durable, read_ours, replace};

use crate::algorithm::Student;

/// The first bytes of the file: name and version of the format.
pub const MAGIC: &[u8; 8] = b"VLLRNR09";

/// Longest file that is read, bytes: a thousand times that of the paper's networks.
const BYTES_MAX: u64 = 1 << 32;

/// All state but the replay, which is in the journal.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Checkpoint {
    /// The algorithm's name, as configured.
    pub algorithm: String,
    /// Networks and optimisers.
    pub student: Student,
    /// State of the random number generator.
    pub random: Xoshiro256PlusPlus,
    /// Steps driven at the end of the last block.
    pub steps: u64,
    /// Updates made.
    pub updates: u64,
    /// Blocks finished.
    pub blocks: u64,
}

impl Checkpoint {
    /// Replaces the file.
    ///
    /// # Errors
    /// When it cannot be written; the old file then stays.
    pub fn write(&self, path: &Path) -> io::Result<()> {
        let body = postcard::to_stdvec(self).map_err(io::Error::other)?;
        let mut bytes = Vec::with_capacity(MAGIC.len() + 4 + body.len());
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&crc32fast::hash(&body).to_le_bytes());
        bytes.extend_from_slice(&body);
        replace(path, &bytes, Durable::Yes)
    }

    /// Reads the file; `None` when there is none.
    ///
    /// # Errors
    /// When it cannot be read, or is damaged or of another version.
    pub fn read(path: &Path) -> io::Result<Option<Checkpoint>> {
        let bytes = match read_ours(path, BYTES_MAX) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(error),
        };
        let damaged = || {
            let what = "is damaged or of another version; move it away to start anew";
            io::Error::new(io::ErrorKind::InvalidData, what)
        };
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(damaged)?;
        let (sum, body) = rest.split_at_checked(4).ok_or_else(damaged)?;
        if crc32fast::hash(body).to_le_bytes() != sum {
            return Err(damaged());
        }
        postcard::from_bytes(body).map(Some).map_err(|_| damaged())
    }
}
