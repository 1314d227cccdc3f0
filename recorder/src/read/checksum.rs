//! The checksums of a whole file.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use mcap::MAGIC;

use super::index::FileIndex;
use crate::RecordingError;

/// Bytes that are read at a time.
const BLOCK: usize = 256 << 10;
/// Bytes of an opcode, a length and the footer before its checksum: two places.
const FOOTER_SUMMED: u64 = 9 + 16;

/// The end of a complete file.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Ends {
    /// Where the record after the data begins, and the checksum of all bytes before it.
    pub(super) data: Option<(u64, u32)>,
    /// Where the footer begins, where the summary does, and the checksum of the latter.
    pub(super) footer: Option<(u64, u64, u32)>,
}

/// Compares the checksums of a file with its bytes. A file whose recorder was stopped has
/// none: its chunks and attachments have their own.
pub(super) fn verify(index: &FileIndex) -> Result<(), RecordingError> {
    let path = index.path.as_path();
    let io = |error| RecordingError::io(path)(error);
    let damaged = |part: &'static str, offset: u64, what: &str| RecordingError::Damaged {
        path: path.into(),
        part,
        offset,
        what: what.into(),
    };
    let mut file = File::open(path).map_err(io)?;
    let length = file.metadata().map_err(io)?.len();
    let mut magic = [0; MAGIC.len()];
    let last = length.saturating_sub(magic.len() as u64);
    file.seek(SeekFrom::Start(last)).map_err(io)?;
    file.read_exact(&mut magic).map_err(io)?;
    let has_magic = magic == *MAGIC;
    let Some((footer, summary, summary_crc)) = index.ends.footer else {
        return match has_magic {
            true => Err(damaged(
                "the file",
                length,
                "it is complete, and the length of a record in it is wrong",
            )),
            false => Ok(()),
        };
    };
    let Some((data, data_crc)) = index.ends.data else {
        return Err(damaged(
            "the file",
            footer,
            "the end of its data is missing",
        ));
    };
    let is_whole = has_magic && footer + FOOTER_SUMMED + 4 == last;
    if !is_whole {
        return Err(damaged("the file's end", footer, "it is no end of a file"));
    }
    // Zero says that it was not computed.
    if data_crc == 0 || crc(path, (0, data))? != data_crc {
        return Err(damaged(
            "the data",
            0,
            "its checksum is wrong; the records of the file are not those that were written",
        ));
    }
    let begin = match summary {
        0 => footer,
        summary => summary,
    };
    if begin > footer || crc(path, (begin, footer + FOOTER_SUMMED))? != summary_crc {
        return Err(damaged("the summary", begin, "its checksum is wrong"));
    }
    Ok(())
}

/// The CRC-32 of the bytes from one place to another.
fn crc(path: &Path, (from, to): (u64, u64)) -> Result<u32, RecordingError> {
    let io = |error| RecordingError::io(path)(error);
    let mut file = BufReader::with_capacity(BLOCK, File::open(path).map_err(io)?);
    file.seek(SeekFrom::Start(from)).map_err(io)?;
    let mut rest = file.take(to.saturating_sub(from));
    let mut sum = crc32fast::Hasher::new();
    let mut block = vec![0; BLOCK];
    loop {
        match rest.read(&mut block).map_err(io)? {
            0 => return Ok(sum.finalize()),
            count => sum.update(&block[..count]),
        }
    }
}
