//! The checked-in corpora of the fuzz targets, on a stable compiler: each input as it
//! is, and with seeded damage.

use std::fs;
use std::path::{Path, PathBuf};

use doors::{Said, TARGETS, Target};

/// Damaged copies of each input, unless `VLAPS_COPIES` says how many.
const COPIES: u64 = 24;
/// All corpora together stay smaller, bytes.
const BYTES_MAX: u64 = 1 << 20;

fn folder(target: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../fuzz/corpus")
        .join(target)
}

/// Name and bytes of every input, in order of name.
fn corpus(target: &str) -> Vec<(String, Vec<u8>)> {
    let folder = folder(target);
    let entries = fs::read_dir(&folder)
        .unwrap_or_else(|error| panic!("{}: {error}; run the example `seeds`", folder.display()));
    let mut inputs: Vec<_> = entries
        .map(|entry| {
            let entry = entry.expect("an entry");
            let name = entry.file_name().display().to_string();
            (name, fs::read(entry.path()).expect("an input"))
        })
        .collect();
    inputs.sort();
    inputs
}

/// Replays each input. Both results must occur: a corpus that is refused completely
/// never reaches the code behind the check, one that is admitted completely never tests
/// the check.
fn replay((name, body): Target) {
    let said: Vec<Said> = corpus(name)
        .iter()
        .map(|(input, bytes)| {
            eprintln!("{name}/{input}");
            body(bytes)
        })
        .collect();
    assert!(
        said.contains(&Said::Admitted),
        "{name}: nothing is admitted"
    );
    assert!(said.contains(&Said::Refused), "{name}: nothing is refused");
}

#[test]
fn every_input_is_refused_or_of_use() {
    for target in TARGETS {
        replay(*target);
    }
}

/// SplitMix64; a damaged copy is identified by its seed.
struct Dice(u64);

impl Dice {
    fn below(&mut self, count: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % count.max(1) as u64) as usize
    }
}

/// Critical numbers: ends of ranges, and values that are not numbers.
const WORDS: [u64; 8] = [
    0,
    u64::MAX,
    0x7ff0_0000_0000_0000,
    0x7ff8_0000_0000_0000,
    0x8000_0000_0000_0000,
    0x0000_0001_0000_0001,
    0x7fef_ffff_ffff_ffff,
    0x0010_0000_0000_0001,
];

fn damage(bytes: &mut Vec<u8>, dice: &mut Dice) {
    for _ in 0..=dice.below(4) {
        let length = bytes.len();
        if length == 0 {
            return;
        }
        match dice.below(5) {
            0 => bytes[dice.below(length)] ^= 1 << dice.below(8),
            1 => bytes[dice.below(length)] = dice.below(256) as u8,
            2 => bytes.truncate(dice.below(length)),
            3 => {
                // Aligned behind the first byte, with which many inputs begin.
                let at = 1 + 8 * dice.below(length / 8);
                let word = WORDS[dice.below(WORDS.len())].to_le_bytes();
                for (to, from) in bytes.iter_mut().skip(at).zip(word) {
                    *to = from;
                }
            }
            _ => {
                let (from, to) = (dice.below(length), dice.below(length));
                let chunk: Vec<u8> = bytes[from..].iter().copied().take(32).collect();
                bytes.splice(to..to, chunk);
            }
        }
    }
}

#[test]
fn damaged_inputs_are_refused_or_of_use() {
    let asked = std::env::var("VLAPS_COPIES").ok();
    let copies = asked.map_or(COPIES, |count| count.parse().expect("a number of copies"));
    for (name, body) in TARGETS {
        for (input, bytes) in corpus(name) {
            for seed in 0..copies {
                let mut copy = bytes.clone();
                damage(&mut copy, &mut Dice(seed));
                eprintln!("{name}/{input} with damage of seed {seed}");
                body(&copy);
            }
        }
    }
}

#[test]
fn every_target_has_its_fuzzer_and_the_corpora_stay_small() {
    let fuzz = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz");
    let mut names: Vec<_> = fs::read_dir(fuzz.join("fuzz_targets"))
        .expect("the targets")
        .map(|entry| entry.expect("an entry").path())
        .map(|path| path.file_stem().expect("a name").display().to_string())
        .collect();
    names.sort();
    let mut expected: Vec<_> = TARGETS.iter().map(|(name, _)| name.to_string()).collect();
    expected.sort();
    assert_eq!(names, expected);
    let bytes: usize = names
        .iter()
        .flat_map(|name| corpus(name))
        .map(|(_, bytes)| bytes.len())
        .sum();
    assert!((bytes as u64) < BYTES_MAX, "{bytes} bytes of corpora");
}
