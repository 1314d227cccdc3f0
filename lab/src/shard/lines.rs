//! The file of a part: a header, then a line for each finished piece. Each line has a
//! checksum and is written at once, so that a process that is killed loses no line but the
//! one that it is writing.
//!
//! A line is `["CRC32C", {...}]`: JSON whose second element has the checksum that is the
//! first, eight hexadecimal digits.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;

use anyhow::{Context, bail};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use shm_config::file::{Durable, replace};

use super::Shard;
use super::terms::Terms;

/// Version of this format; files of other versions are refused.
const FORMAT: u32 = 1;
/// Maximum size of a header, bytes: a hundred times that of one with every setting.
const HEADER_BYTES_MAX: u64 = 1 << 20;
/// Maximum size of a file, bytes: a million episodes with their planning times have less.
const BYTES_MAX: u64 = 4 << 30;

/// Maximum number of pieces; the most that a command line makes is a million.
const PIECES_MAX: u64 = 10_000_000;

/// The file is of another version.
#[derive(Debug)]
pub struct OtherFormat(u32);

impl fmt::Display for OtherFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let OtherFormat(found) = self;
        write!(f, "has format {found}, this build reads format {FORMAT}")
    }
}

impl std::error::Error for OtherFormat {}

/// The only key that headers of all versions have.
#[derive(Deserialize)]
struct Version {
    vlaps_shard: u32,
}

/// The first line.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Version of the format.
    pub vlaps_shard: u32,
    /// Number of the part, from 1 on.
    pub number: u32,
    /// Number of parts.
    pub of: u32,
    /// Number of pieces of all parts.
    pub pieces: u64,
    /// Name of what is driven, as the command line gave it; parts may differ in it.
    pub label: String,
    /// The machine that began the part; parts may differ in it.
    pub machine: String,
    /// What all parts have in common.
    pub terms: Terms,
}

impl Header {
    /// The header of a part.
    pub fn new(shard: Shard, (pieces, label): (u64, &str), terms: &Terms) -> Header {
        let machine = crate::report::Machine::here().ok();
        let machine = machine.and_then(|machine| machine.processor);
        Header {
            vlaps_shard: FORMAT,
            number: shard.number,
            of: shard.of,
            pieces,
            label: label.into(),
            machine: machine.unwrap_or_default(),
            terms: terms.clone(),
        }
    }

    /// The part.
    pub fn shard(&self) -> Shard {
        Shard {
            number: self.number,
            of: self.of,
        }
    }

    /// Checks that it is the header of a part of this name.
    fn check(&self, named: Shard) -> anyhow::Result<()> {
        if self.shard() != named {
            bail!("holds shard {}, its name says {named}", self.shard());
        }
        // Recordings may hold no event; every other command has a piece at least.
        let least = u64::from(self.terms.get("command")? != "regress");
        if !(least..=PIECES_MAX).contains(&self.pieces) {
            let found = self.pieces;
            bail!("names {found} pieces, where {least} to {PIECES_MAX} are possible");
        }
        Ok(())
    }
}

/// One finished piece.
#[derive(Serialize, Deserialize)]
struct Line<T> {
    /// Its index among all pieces.
    piece: u64,
    result: T,
}

/// What a file holds.
#[derive(Clone, Debug)]
pub struct Content<T> {
    /// The header.
    pub header: Header,
    /// The results by the index of their piece.
    pub results: BTreeMap<u64, T>,
    /// Lines that cannot be used, with the reason of the first: their pieces count as
    /// missing.
    pub damaged: Option<(usize, String)>,
    /// Whether the last line is incomplete, as after a kill.
    pub is_torn: bool,
}

/// One line with its checksum, without the end.
fn line_of(value: &impl Serialize) -> anyhow::Result<String> {
    let text = serde_json::to_string(value)?;
    Ok(format!(
        "[\"{:08x}\", {text}]",
        crc32c::crc32c(text.as_bytes())
    ))
}

/// The value of a line.
fn value_of<T: DeserializeOwned>(line: &str) -> anyhow::Result<T> {
    let parts = line
        .strip_prefix("[\"")
        .and_then(|rest| rest.strip_suffix(']'));
    let (sum, text) = parts
        .and_then(|rest| rest.split_once("\", "))
        .context("is no line of a shard")?;
    let sum = u32::from_str_radix(sum, 16).context("its checksum is no number")?;
    if sum != crc32c::crc32c(text.as_bytes()) {
        bail!("its checksum is wrong");
    }
    serde_json::from_str(text).context("has other keys than this build writes")
}

/// Reads the header of a file alone.
///
/// # Errors
/// As [`read`].
pub fn read_header(path: &Path, named: Shard) -> anyhow::Result<Header> {
    shm_config::file::regular(path)?;
    let file = File::open(path)?;
    let mut first = Vec::new();
    BufReader::new(file.take(HEADER_BYTES_MAX)).read_until(b'\n', &mut first)?;
    // Bytes that are not UTF-8 fail the checksum.
    let first = String::from_utf8_lossy(&first);
    let first = first.strip_suffix('\n').context("has no complete header")?;
    header_of(first, named)
}

fn header_of(first: &str, named: Shard) -> anyhow::Result<Header> {
    let Version { vlaps_shard } = value_of(first).context("its header")?;
    if vlaps_shard != FORMAT {
        return Err(OtherFormat(vlaps_shard).into());
    }
    let header: Header = value_of(first).context("its header")?;
    header.check(named)?;
    Ok(header)
}

/// Reads a file.
///
/// # Errors
/// If it cannot be read, or its header is not that of the part that it is named after.
pub fn read<T>(path: &Path, named: Shard) -> anyhow::Result<Content<T>>
where
    T: DeserializeOwned + PartialEq,
{
    let bytes = shm_config::file::read(path, BYTES_MAX)?;
    // Bytes that are no text cost their line alone: its checksum is wrong then.
    let text = String::from_utf8_lossy(&bytes);
    let (first, rest) = text.split_once('\n').context("has no complete header")?;
    let header = header_of(first, named)?;
    let range = named.range(header.pieces);
    let mut content = Content {
        header,
        results: BTreeMap::new(),
        damaged: None,
        is_torn: !rest.is_empty() && !rest.ends_with('\n'),
    };
    let whole = rest.rfind('\n').map_or("", |end| &rest[..end]);
    for (index, line) in whole.split_terminator('\n').enumerate() {
        let added = value_of::<Line<T>>(line).and_then(|Line { piece, result }| {
            if !range.contains(&piece) {
                bail!("holds piece {piece}, which is of another shard");
            }
            match content.results.get(&piece) {
                Some(other) if *other != result => bail!("has a second result of piece {piece}"),
                _ => {
                    content.results.insert(piece, result);
                    Ok(())
                }
            }
        });
        if let Err(error) = added {
            // The header is line 1.
            let reason = format!("line {} {error:#}", index + 2);
            let (count, _) = content.damaged.get_or_insert((0, reason));
            *count += 1;
        }
    }
    Ok(content)
}

/// Writes a file anew, whole or not at all.
///
/// # Errors
/// If it cannot be written.
pub fn write<T: Serialize>(
    path: &Path,
    header: &Header,
    results: &BTreeMap<u64, T>,
) -> anyhow::Result<()> {
    let mut text = line_of(header)? + "\n";
    for (piece, result) in results {
        let piece = *piece;
        text += &(line_of(&Line { piece, result })? + "\n");
    }
    replace(path, text.as_bytes(), Durable::Yes).with_context(|| path.display().to_string())
}

/// Appends a result with a single write.
///
/// # Errors
/// If it cannot be written.
pub fn append<T: Serialize>(
    (file, path): (&mut File, &Path),
    piece: u64,
    result: &T,
) -> anyhow::Result<()> {
    let line = line_of(&Line { piece, result })? + "\n";
    file.write_all(line.as_bytes())
        .with_context(|| path.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(folder: &Path) -> std::path::PathBuf {
        let shard = Shard { number: 2, of: 2 };
        let header = Header::new(shard, (6, "idm"), &Terms::new("eval", shard));
        let path = folder.join(shard.file_name());
        let results = BTreeMap::from([(3, "three".to_string()), (4, "four".to_string())]);
        write(&path, &header, &results).expect("written");
        path
    }

    fn read_again(path: &Path) -> anyhow::Result<Content<String>> {
        read(path, Shard { number: 2, of: 2 })
    }

    #[test]
    fn any_truncation_keeps_every_whole_line() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = file(folder.path());
        let whole = std::fs::read(&path).expect("bytes");
        let ends: Vec<usize> = (0..whole.len()).filter(|k| whole[*k] == b'\n').collect();
        for length in 0..=whole.len() {
            std::fs::write(&path, &whole[..length]).expect("written");
            let lines = ends.iter().filter(|end| **end < length).count();
            match read_again(&path) {
                Err(_) => assert_eq!(lines, 0, "{length} bytes"),
                Ok(content) => {
                    assert_eq!(content.results.len(), lines - 1, "{length} bytes");
                    assert_eq!(content.damaged, None);
                    assert_eq!(content.is_torn, !ends.contains(&(length - 1)));
                }
            }
        }
    }

    #[test]
    fn a_flipped_bit_costs_its_line_alone() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = file(folder.path());
        let whole = std::fs::read(&path).expect("bytes");
        let header = whole.iter().position(|b| *b == b'\n').expect("a line");
        // The first stays ASCII and makes no new line; the second is no text.
        for (at, bit) in (0..whole.len()).flat_map(|at| [(at, 0x10), (at, 0x80)]) {
            let mut bytes = whole.clone();
            bytes[at] ^= bit;
            std::fs::write(&path, &bytes).expect("written");
            let read = read_again(&path);
            let header_alone = read_header(&path, Shard { number: 2, of: 2 });
            if at <= header {
                assert!(read.is_err() && header_alone.is_err(), "byte {at}, {bit}");
            } else {
                let content = read.expect("the header is whole");
                assert!(header_alone.is_ok(), "byte {at}, {bit}");
                assert!(content.results.len() < 2, "byte {at}, {bit}");
                let is_told = content.damaged.is_some() || content.is_torn;
                assert!(is_told, "byte {at}, {bit}");
            }
        }
    }

    #[test]
    fn a_header_of_another_version_or_of_impossible_work_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = file(folder.path());
        let shard = Shard { number: 2, of: 2 };
        let refused = |value: &serde_json::Value| {
            let text = line_of(value).expect("a line") + "\n";
            std::fs::write(&path, text).expect("written");
            read_header(&path, shard).expect_err("refused")
        };
        let later = refused(&serde_json::json!({ "vlaps_shard": 2, "new": true }));
        assert!(later.downcast_ref::<OtherFormat>().is_some(), "{later:#}");
        for (command, pieces) in [("eval", 0), ("eval", 1 << 63), ("regress", u64::MAX)] {
            let header = Header::new(shard, (pieces, "idm"), &Terms::new(command, shard));
            let header = serde_json::to_value(header).expect("a value");
            let error = refused(&header).to_string();
            assert!(error.contains("are possible"), "{error}");
        }
        let header = Header::new(shard, (0, "no event"), &Terms::new("regress", shard));
        write(&path, &header, &BTreeMap::<u64, String>::new()).expect("written");
        assert_eq!(read_header(&path, shard).expect("a header").pieces, 0);
    }

    #[test]
    fn foreign_files_and_pieces_are_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = file(folder.path());
        let text = std::fs::read_to_string(&path).expect("text");
        let other_keys = line_of(&serde_json::json!({})).expect("a line") + "\n";
        for (bytes, hint) in [
            ("", "no complete header"),
            ("# a note\n", "is no line of a shard"),
            ("[\"00000000\", {}]\n", "checksum is wrong"),
            (other_keys.as_str(), "other keys"),
        ] {
            std::fs::write(&path, bytes).expect("written");
            let error = format!("{:#}", read_again(&path).expect_err("refused"));
            assert!(error.contains(hint), "{bytes:?}: {error}");
        }
        std::fs::write(&path, &text).expect("written");
        let error = read::<String>(&path, Shard { number: 1, of: 2 }).expect_err("its name");
        assert!(format!("{error:#}").contains("its name says 1/2"));
        for (piece, result, hint) in [
            (0, "zero", "is of another shard"),
            (3, "other", "second result of piece 3"),
        ] {
            let line = line_of(&Line { piece, result }).expect("a line");
            std::fs::write(&path, format!("{text}{line}\n")).expect("written");
            let content = read_again(&path).expect("the rest");
            let (count, reason) = content.damaged.expect("told");
            assert!(count == 1 && reason.contains(hint), "{reason}");
            assert_eq!(content.results.len(), 2);
        }
        // The same result twice counts once.
        let line = text.lines().nth(1).expect("a line");
        std::fs::write(&path, format!("{text}{line}\n")).expect("written");
        let content = read_again(&path).expect("read");
        assert_eq!((content.results.len(), content.damaged), (2, None));
    }
}
