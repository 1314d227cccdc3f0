//! Work in parts: `--shard I/N` does one of N parts of a command's work and keeps its
//! results in the folder of `--out`; `--report` merges the parts that are there.
//!
//! | module | holds |
//! |---|---|
//! | [`terms`] | what all parts of one piece of work have in common |
//! | [`lines`] | the file of a part: a header, and a line with a checksum for each result |
//! | [`folder`] | begins or continues a part; refuses one of other work |
//! | [`merge`] | reads all parts, and says what is missing |
//! | [`exact`] | numbers in text that are read back bit by bit |
//!
//! The work of a command is a list of pieces, such as the episodes of an evaluation. A part
//! holds a run of consecutive pieces. A piece depends on its index and the terms alone, so
//! the figures do not depend on how the work was divided.

pub mod exact;
pub mod folder;
pub mod lines;
pub mod merge;
pub mod terms;

use std::fmt;
use std::ops::Range;
use std::path::Path;
use std::str::FromStr;

use supervisor::cli::failure::Failure;

/// Maximum number of parts: each is a file in one folder, and a report opens all of them.
const SHARDS_MAX: u32 = 10_000;

/// The error of `--out` without a part or a report.
pub fn needs_shard() -> anyhow::Error {
    let line = "--out: needs --shard I/N, which drives a part, or --report";
    Failure::Usage(line.into()).into()
}

/// The error of a command without `--shard` in a folder of parts.
pub fn holds_shards(out: &Path) -> anyhow::Error {
    Failure::Usage(format!(
        "{}: contains shards; --shard I/N continues one, --report merges them",
        out.display()
    ))
    .into()
}

/// One of several parts of a piece of work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Shard {
    /// Its number, from 1 on.
    pub number: u32,
    /// Number of parts.
    pub of: u32,
}

impl Shard {
    /// All parts of a piece of work.
    pub fn all(of: u32) -> impl Iterator<Item = Shard> {
        (1..=of).map(move |number| Shard { number, of })
    }

    /// Its pieces of this many. Parts differ by one piece at most.
    pub fn range(self, pieces: u64) -> Range<u64> {
        let from = |number: u32| {
            let product = u128::from(pieces) * u128::from(number);
            (product / u128::from(self.of)) as u64
        };
        from(self.number - 1)..from(self.number)
    }

    /// Name of its file.
    pub fn file_name(self) -> String {
        format!("shard-{}-of-{}.jsonl", self.number, self.of)
    }

    /// The part that a file's name names.
    pub fn of_file_name(name: &str) -> Option<Shard> {
        let middle = name.strip_prefix("shard-")?.strip_suffix(".jsonl")?;
        let (number, of) = middle.split_once("-of-")?;
        let shard: Shard = format!("{number}/{of}").parse().ok()?;
        // A name such as shard-01-of-8 would be a second one for the same part.
        (shard.file_name() == name).then_some(shard)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Shard, String> {
        let refused = || {
            format!(
                "must be I/N, such as 1/8: part I of N, with I from 1 to N and N up to {SHARDS_MAX}"
            )
        };
        let (number, of) = text.split_once('/').ok_or_else(refused)?;
        let whole = |text: &str| text.parse::<u32>().map_err(|_| refused());
        // 0+1/8 for systems that count from 0 and cannot add, as Kubernetes does.
        let number = match number.split_once('+') {
            Some((index, "1")) => whole(index)?.saturating_add(1),
            Some(_) => return Err(refused()),
            None => whole(number)?,
        };
        let of = whole(of)?;
        match (1..=SHARDS_MAX).contains(&of) && (1..=of).contains(&number) {
            true => Ok(Shard { number, of }),
            false => Err(refused()),
        }
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parts_hold_every_piece_once() {
        for (pieces, of) in [(0, 3), (1, 8), (7, 3), (8, 8), (1_000_000, 7), (3, 10)] {
            let mut next = 0;
            for shard in Shard::all(of) {
                let range = shard.range(pieces);
                assert_eq!(range.start, next, "{pieces} pieces, {shard}");
                let least = pieces / u64::from(of);
                assert!((least..=least + 1).contains(&(range.end - range.start)));
                next = range.end;
            }
            assert_eq!(next, pieces);
        }
        let last = Shard { number: 3, of: 3 };
        assert_eq!(last.range(u64::MAX).end, u64::MAX, "no overflow");
    }

    #[test]
    fn a_part_is_written_as_i_of_n() {
        let shard: Shard = "3/8".parse().expect("a part");
        assert_eq!(shard, Shard { number: 3, of: 8 });
        assert_eq!(Shard::of_file_name(&shard.file_name()), Some(shard));
        assert_eq!("2+1/8".parse(), Ok(shard), "of a system that counts from 0");
        for bad in [
            "",
            "3",
            "0/8",
            "9/8",
            "3/0",
            "-1/8",
            "3/8/1",
            "3/10001",
            "a/8",
            "1.0/2",
            "/",
            "8+1/8",
            "2+2/8",
            "+1/8",
            "4294967295+1/8",
        ] {
            let error = bad.parse::<Shard>().expect_err(bad);
            assert!(error.contains("such as 1/8"), "{bad}: {error}");
        }
        for name in [
            "shard-3-of-8.json",
            "shard-03-of-8.jsonl",
            "shard-9-of-8.jsonl",
            "shard-3-of-8.jsonl.1-0",
            "shard-3-of-8 (copy).jsonl",
        ] {
            assert_eq!(Shard::of_file_name(name), None, "{name}");
        }
    }
}
