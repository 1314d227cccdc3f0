//! What a recording says about the machine and the programs that ran.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, BufRead, BufReader};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};
use shm_config::config::Config;
use shm_config::services::Process;

use crate::Origin;

/// The origin of a recording of this run, whose supervisor has this process id.
pub(super) fn origin(config: &Config, supervisor: u32, offset_ns: u64) -> Origin {
    Origin {
        run: config.run.name.clone(),
        session: session(supervisor),
        is_lockstep: config.run.is_lockstep(),
        epoch_offset_ns: offset_ns,
        facts: facts(config),
    }
}

/// Distinguishes the supervisor from all others of this machine: its process id, and when
/// it was started after which boot.
pub(super) fn session(supervisor: u32) -> String {
    let stat = fs::read_to_string(format!("/proc/{supervisor}/stat")).unwrap_or_default();
    // The name before it may have blanks; the start is the 20th field after it.
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let start = after_name.split_whitespace().nth(19).unwrap_or("0");
    let boot = fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    let boot: String = boot.chars().take(8).collect();
    format!("{boot}-{supervisor}-{start}")
}

fn facts(config: &Config) -> BTreeMap<String, String> {
    let mut facts = BTreeMap::new();
    facts.insert("rate_hz".into(), config.run.rate_hz.to_string());
    if let Some(processor) = processor() {
        facts.insert("processor".into(), processor);
    }
    let Ok(program) = std::env::current_exe() else {
        return facts;
    };
    let Some(folder) = program.parent() else {
        return facts;
    };
    if let Some(commit) = commit(folder) {
        facts.insert("commit".into(), commit);
    }
    facts.extend(binaries(config, folder));
    facts
}

fn processor() -> Option<String> {
    let text = fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().to_string())
}

/// The SHA-256 of the program of each process: the user's, or the one beside this program.
fn binaries(config: &Config, folder: &Path) -> impl Iterator<Item = (String, String)> {
    Process::ALL.iter().filter_map(move |process| {
        // A process of another machine has a program that stands in its place here.
        let stand_in = config.link.of(*process).map(|(program, _)| program);
        let name = stand_in.unwrap_or_else(|| process.binary());
        // The world of another simulator is a script in Python, not the program of the build.
        let is_foreign = *process == Process::World && !config.has_built_in_world();
        let hash = match config.programs.of(*process) {
            Some(path) => sha256_of_file(path),
            None if is_foreign => return None,
            None => sha256_of_file(&folder.join(name)),
        };
        Some((format!("binary.{name}"), hash.ok()?))
    })
}

fn sha256_of_file(path: &Path) -> io::Result<String> {
    let mut hash = Sha256::new();
    let mut file = BufReader::with_capacity(1 << 16, File::open(path)?);
    loop {
        let bytes = file.fill_buf()?;
        let count = bytes.len();
        if count == 0 {
            return Ok(hex(&hash.finalize()));
        }
        hash.update(bytes);
        file.consume(count);
    }
}

/// Bytes in hexadecimal.
pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The commit that is checked out in the folder above the programs; `None` outside of one.
fn commit(folder: &Path) -> Option<String> {
    let git = folder
        .ancestors()
        .map(|folder| folder.join(".git"))
        .find(|git| git.exists())?;
    let git = match git.is_file() {
        // A work tree beside the repository names its folder.
        true => PathBuf::from(
            fs::read_to_string(&git)
                .ok()?
                .strip_prefix("gitdir:")?
                .trim(),
        ),
        false => git,
    };
    let head = fs::read_to_string(git.join("HEAD")).ok()?;
    let Some(branch) = head.trim().strip_prefix("ref: ") else {
        return Some(head.trim().to_string());
    };
    let common = fs::read_to_string(git.join("commondir"));
    let common = common.map_or(git.clone(), |common| git.join(common.trim()));
    if let Ok(commit) = fs::read_to_string(common.join(branch)) {
        return Some(commit.trim().to_string());
    }
    let packed = fs::read_to_string(common.join("packed-refs")).ok()?;
    let line = packed
        .lines()
        .find(|line| line.ends_with(&format!(" {branch}")))?;
    Some(line.split_once(' ')?.0.to_string())
}

#[cfg(test)]
mod tests {
    use shm_config::config::Simulator;

    use super::*;

    #[test]
    fn a_program_of_the_user_is_hashed_in_place_of_that_of_the_build() {
        let folder = tempfile::tempdir().expect("a folder");
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            fs::write(&path, text).expect("a program");
            path.display().to_string()
        };
        for process in [Process::World, Process::Planner] {
            write(process.binary(), "of the build");
        }
        let mut config = Config::default();
        config.programs.world = write("my-robot", "of the user");
        let hash_of = |text: &str| hex(&Sha256::digest(text));
        let expected = [
            (Process::World, hash_of("of the user")),
            (Process::Planner, hash_of("of the build")),
        ];
        let expected =
            expected.map(|(process, hash)| (format!("binary.{}", process.binary()), hash));
        let found: BTreeMap<String, String> = binaries(&config, folder.path()).collect();
        assert_eq!(found, BTreeMap::from(expected));
    }

    #[test]
    fn what_stands_for_a_process_elsewhere_is_hashed_by_its_own_name() {
        let folder = tempfile::tempdir().expect("a folder");
        for name in [
            "vlaps-world",
            "vlaps-planner",
            "vlaps-gate",
            "vlaps-link-judge",
        ] {
            fs::write(folder.path().join(name), name).expect("a program");
        }
        let mut config = Config::default();
        config.link.judge = "0.0.0.0:7450".into();
        config.world.simulator = Simulator::MetaDrive;
        let found: Vec<String> = binaries(&config, folder.path())
            .map(|(key, _)| key)
            .collect();
        assert_eq!(found.len(), 2, "{found:?}");
        for key in ["binary.vlaps-planner", "binary.vlaps-link-judge"] {
            assert!(found.iter().any(|found| found == key), "{found:?}");
        }
    }
}
