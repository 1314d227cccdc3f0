//! Reads all parts in a folder, and says what is missing.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::Serialize;
use serde::de::DeserializeOwned;
use shm_config::counted;
use supervisor::cli::failure::Failure;
use supervisor::subcommand::say;

use super::Shard;
use super::lines::{self, Content, Header};

/// The file of a part, with its header where that can be read.
pub struct Found {
    /// The file.
    pub path: PathBuf,
    /// The part that its name names.
    pub shard: Shard,
    /// Its header.
    pub header: anyhow::Result<Header>,
}

/// The files in a folder that are named as parts, in the order of the parts; none if the
/// folder does not exist.
///
/// # Errors
/// If the folder cannot be read.
pub fn found(out: &Path) -> anyhow::Result<Vec<Found>> {
    let mut found = Vec::new();
    for (shard, path) in paths(out)? {
        let header = lines::read_header(&path, shard);
        found.push(Found {
            path,
            shard,
            header,
        });
    }
    Ok(found)
}

/// Whether the folder holds the file of a part.
///
/// # Errors
/// If the folder cannot be read.
pub fn is_sharded(out: &Path) -> anyhow::Result<bool> {
    Ok(!paths(out)?.is_empty())
}

fn paths(out: &Path) -> anyhow::Result<Vec<(Shard, PathBuf)>> {
    let entries = match fs::read_dir(out) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(error).with_context(|| out.display().to_string()),
    };
    let mut paths = Vec::new();
    for entry in entries {
        let path = entry.with_context(|| out.display().to_string())?.path();
        let name = path.file_name().and_then(|name| name.to_str());
        if let Some(shard) = name.and_then(Shard::of_file_name) {
            paths.push((shard, path));
        }
    }
    paths.sort();
    Ok(paths)
}

/// Figures with what is missing of them: the JSON object of an incomplete report.
#[derive(Serialize)]
pub struct Partial<T> {
    /// What is there.
    #[serde(flatten)]
    pub figures: T,
    /// What is missing.
    pub missing: MissingParts,
}

/// A part that is not complete.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Missing {
    /// The part, such as `3/8`.
    pub shard: String,
    /// Number of its pieces that are missing.
    pub missing: u64,
    /// Number of its pieces.
    pub pieces: u64,
}

/// What is missing; the key `missing` of `--json`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct MissingParts {
    /// Number of pieces that are missing.
    pub pieces: u64,
    /// The parts that are not complete.
    pub shards: Vec<Missing>,
}

/// The parts of one piece of work.
pub struct Merged<T> {
    /// The header of the first part that is there.
    pub header: Header,
    /// All results by the index of their piece, each once.
    pub results: BTreeMap<u64, T>,
}

impl<T: DeserializeOwned + PartialEq> Merged<T> {
    /// Reads all parts, and prints a line for each file that cannot be used.
    ///
    /// # Errors
    /// If there is none, or they are of different work or of another command.
    pub fn read(out: &Path, command: &str) -> anyhow::Result<Merged<T>> {
        let files = headers(out, command)?;
        let Some(header) = files.first().map(|(_, header)| header.clone()) else {
            return Err(no_shard(out, command));
        };
        let mut results = BTreeMap::new();
        for (path, header) in files {
            let content: Content<T> = match lines::read(&path, header.shard()) {
                Ok(content) => content,
                Err(error) => {
                    useless(&path, &error);
                    continue;
                }
            };
            if let Some((count, reason)) = &content.damaged {
                say(format_args!(
                    "{}: {} cannot be used ({reason}), counted as missing",
                    path.display(),
                    counted(*count, "line")
                ));
            }
            results.extend(content.results);
        }
        Ok(Merged { header, results })
    }

    /// Checks that the work has as many pieces as its options make.
    ///
    /// # Errors
    /// If the headers say another number.
    pub fn check_pieces(&self, asked: u64) -> anyhow::Result<()> {
        let pieces = self.header.pieces;
        anyhow::ensure!(
            pieces == asked,
            "the shards name {pieces} pieces, where their options make {asked}; their headers are \
             damaged or by another program"
        );
        Ok(())
    }

    /// What is missing; `None` if nothing is.
    pub fn missing(&self) -> Option<MissingParts> {
        let there = self.results.keys().copied().collect();
        missing_parts(&missing(&self.header, &there))
    }

    /// The incomplete parts, where a piece counts only if `is_there` finds its files.
    ///
    /// # Errors
    /// Those of `is_there`.
    pub fn missing_unless(
        &self,
        mut is_there: impl FnMut(u64, &T) -> anyhow::Result<bool>,
    ) -> anyhow::Result<Vec<Missing>> {
        let mut there = BTreeSet::new();
        for (piece, result) in &self.results {
            if is_there(*piece, result)? {
                there.insert(*piece);
            }
        }
        Ok(missing(&self.header, &there))
    }
}

/// The parts that lack pieces.
fn missing(header: &Header, there: &BTreeSet<u64>) -> Vec<Missing> {
    let short = Shard::all(header.of).filter_map(|shard| {
        let range = shard.range(header.pieces);
        let pieces = range.end - range.start;
        let missing = pieces - there.range(range).count() as u64;
        (missing > 0).then(|| Missing {
            shard: shard.to_string(),
            missing,
            pieces,
        })
    });
    short.collect()
}

/// The sum of what is missing; `None` if nothing is.
pub fn missing_parts(missing: &[Missing]) -> Option<MissingParts> {
    (!missing.is_empty()).then(|| MissingParts {
        pieces: missing.iter().map(|part| part.missing).sum(),
        shards: missing.to_vec(),
    })
}

/// Number of incomplete parts that are listed.
const LISTED: usize = 20;

impl MissingParts {
    /// Prints which parts are missing, and how to run them.
    pub fn tell(&self, header: &Header, unit: &str) {
        let each = self.shards.iter().take(LISTED).map(|part| {
            let Missing {
                shard,
                missing,
                pieces,
            } = part;
            match missing == pieces {
                true => shard.clone(),
                false => format!("{shard} ({missing} of {})", counted(*pieces, unit)),
            }
        });
        let each: Vec<String> = each.collect();
        let more = match self.shards.len().saturating_sub(LISTED) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        say(format_args!(
            "incomplete: {} of {} missing, of shards {}{more}; run them with --shard I/{} --out \
             DIR and the options of the others",
            self.pieces,
            counted(header.pieces, unit),
            each.join(", "),
            header.of
        ));
    }
}

/// The readable headers of all parts, which are of the same work and of this command.
/// Prints a line for each file without one.
///
/// # Errors
/// If they are of different work or of another command.
pub fn headers(out: &Path, command: &str) -> anyhow::Result<Vec<(PathBuf, Header)>> {
    let mut headers: Vec<(PathBuf, Header)> = Vec::new();
    for Found { path, header, .. } in found(out)? {
        match header {
            Ok(header) => headers.push((path, header)),
            Err(error) => useless(&path, &error),
        }
    }
    let Some((first, header)) = headers.first() else {
        return Ok(headers);
    };
    let of = header.terms.get("command")?;
    if of != command {
        return Err(Failure::Usage(format!(
            "{}: is a shard of ./vlaps {of}; ./vlaps {of} --out {} --report merges it",
            first.display(),
            out.display()
        ))
        .into());
    }
    for (path, other) in &headers {
        let difference = header.terms.difference(&other.terms);
        let pieces = || format!("number of pieces {}, not {}", header.pieces, other.pieces);
        let difference = difference.or_else(|| (header.pieces != other.pieces).then(pieces));
        if let Some(difference) = difference {
            return Err(Failure::Usage(format!(
                "{} and {}: shards of different work: {difference}; keep those of one in the \
                 folder",
                first.display(),
                path.display()
            ))
            .into());
        }
    }
    Ok(headers)
}

/// Prints that a finished training of a part is not what its folder holds.
pub fn tell_other_training(folder: &Path) {
    say(format_args!(
        "{}: is not the complete training that its shard names, counted as missing",
        folder.display()
    ));
}

fn useless(path: &Path, error: &anyhow::Error) {
    say(format_args!(
        "{}: cannot be used ({error:#}), counted as missing",
        path.display()
    ));
}

/// The error of a report without a part.
pub fn no_shard(out: &Path, command: &str) -> anyhow::Error {
    let out = out.display();
    Failure::Usage(format!(
        "{out}: contains no shard; ./vlaps {command} ... --shard 1/8 --out {out} makes one"
    ))
    .into()
}
