//! The experiment's numbers, as configuration of a run.

use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use anyhow::bail;
use shm_config::config::{Algorithm, Config, load};
use shm_config::run::name_max;
use supervisor::cli::failure::Failure;
use toml::{Table, Value};

use super::experiment::Experiment;
use super::results::CONFIG;
use supervisor::commands::up::arguments::WorldChoice;
use supervisor::subcommand::settings;

/// Seeds that are trained on: 100 to 149.
const TRAINING_SEED: u64 = 100;
/// How many of them.
const TRAINING_SEEDS: u32 = 50;
/// First seed that is evaluated on: 1000 to 1049.
pub const EVALUATION_SEED: u64 = 1000;
/// Length of a step, s.
pub const STEP_S: f64 = 0.1;

/// One training of the experiment.
#[derive(Clone, Debug)]
pub struct Protocol {
    /// Its seed.
    pub seed: u64,
    /// Its folder.
    pub folder: PathBuf,
    /// Steps to train for.
    pub steps: u64,
    /// Episodes after each block.
    pub episodes: u64,
    /// The run's configuration, without its length.
    pub config: Config,
}

impl Protocol {
    /// The training of this seed.
    ///
    /// # Errors
    /// When the configuration or an override is wrong.
    pub fn new(experiment: &Experiment, (seed, out): (u64, &Path)) -> anyhow::Result<Protocol> {
        check_own(&experiment.set)?;
        let folder = out.join(format!("seed-{seed}"));
        let mut overrides = preset(experiment, seed);
        overrides.push(format!("run.name={}", run_name(out, seed)));
        overrides.extend(experiment.set.iter().cloned());
        let mut config = settings::config(experiment.config.as_deref(), &overrides)?;
        config.run.folder = folder.display().to_string();
        let block_steps = u64::from(config.learner.block_steps);
        if !experiment.steps.is_multiple_of(block_steps) {
            let message = format!(
                "--steps {}: must be a multiple of learner.block_steps, {block_steps}",
                experiment.steps
            );
            return Err(Failure::Usage(message).into());
        }
        let protocol = Protocol {
            seed,
            folder,
            steps: experiment.steps,
            episodes: experiment.eval_episodes,
            config,
        };
        protocol.check_same()?;
        Ok(protocol)
    }

    /// The file that a training's process set is configured with.
    pub fn file(&self) -> PathBuf {
        self.folder.join(CONFIG)
    }

    /// A training that is gone on with has the configuration that it began with,
    /// as far as it decides what is learnt.
    fn check_same(&self) -> anyhow::Result<()> {
        let file = self.file();
        if !file.exists() {
            return Ok(());
        }
        let begun = Table::try_from(load(&file)?)?;
        let now = Table::try_from(&self.config)?;
        let mut differences = Vec::new();
        for section in SAME {
            compare(
                section,
                begun.get(section),
                now.get(section),
                &mut differences,
            );
        }
        if !differences.is_empty() {
            bail!(
                "{}: the training was begun otherwise: {}; leave these options out, or give \
                 those it was begun with; --out DIR begins another experiment",
                file.display(),
                differences.join(", ")
            );
        }
        Ok(())
    }
}

/// The sections of the configuration that decide what is learnt.
const SAME: [&str; 11] = [
    "vehicle",
    "world",
    "planner",
    "informed",
    "kinodynamic",
    "mpc",
    "controller",
    "judge",
    "gate",
    "policy",
    "learner",
];

/// Collects the keys with other values, as `key = begun, not now`.
fn compare(key: &str, begun: Option<&Value>, now: Option<&Value>, out: &mut Vec<String>) {
    if let (Some(Value::Table(begun)), Some(Value::Table(now))) = (begun, now) {
        for (inner, value) in now {
            let key = format!("{key}.{inner}");
            compare(&key, begun.get(inner), Some(value), out);
        }
        return;
    }
    if let (Some(begun), Some(now)) = (begun, now)
        && begun != now
    {
        out.push(format!("{key} = {begun}, not {now}"));
    }
}

/// Keys that an experiment sets by itself, and what to do
/// in place of that.
const OWN: [(&str, &str); 6] = [
    ("run.clock", "a training drives in lockstep"),
    ("run.duration_s", "--steps says how long it drives"),
    ("run.folder", "--out names the folder"),
    ("learner.enabled", "a training always learns"),
    ("learner.algorithm", "--algorithm says how it learns"),
    ("learner.seed", "--seed and --seeds say it"),
];

/// No override is of a key that would be passed over, or give all seeds the same. In
/// a configuration file these keys are for other commands.
fn check_own(overrides: &[String]) -> Result<(), Failure> {
    for text in overrides {
        if let Some((_, instead)) = OWN.iter().find(|(own, _)| *own == settings::key(text)) {
            return Err(Failure::Usage(format!(
                "--set {text}: is not for ./vlaps train to choose: {instead}"
            )));
        }
    }
    Ok(())
}

/// The folder's name, as much of it as a run's name may hold, a sum of its whole path,
/// and the seed: experiments run side by side, independent of the names of their folders.
fn run_name(out: &Path, seed: u64) -> String {
    let out = whole(out);
    let folder = out.file_name().unwrap_or_default().to_string_lossy();
    let name = folder.chars().map(|c| match c.is_ascii_alphanumeric() {
        true => c,
        false => '-',
    });
    // Six digits: one pair of folders in 17 million has the same.
    let sum = crc32c::crc32c(out.as_os_str().as_bytes()) & 0xff_ffff;
    let end = format!("-{sum:06x}-{seed}");
    let letters = name_max().saturating_sub(end.len());
    name.take(letters).chain(end.chars()).collect()
}

/// A folder's path without links and detours, the same before and after it is made.
fn whole(folder: &Path) -> PathBuf {
    let path = std::path::absolute(folder).unwrap_or_else(|_| folder.into());
    let found = path.ancestors().find_map(|there| {
        let rest = path.strip_prefix(there).ok()?;
        Some(there.canonicalize().ok()?.join(rest))
    });
    // Without the slash behind a folder that is there.
    found.unwrap_or(path).components().collect()
}

/// What the experiment sets, before the user's own overrides.
fn preset(experiment: &Experiment, seed: u64) -> Vec<String> {
    // Of an expert's own driving nothing but the expert's own driving is learnt.
    let gate = match experiment.algorithm {
        Algorithm::Bc => "expert",
        Algorithm::Pvp | Algorithm::Ppl | Algorithm::HgDagger | Algorithm::Dagger => "rules",
    };
    let mut keys = vec![
        format!("run.seed={TRAINING_SEED}"),
        format!("run.seeds={TRAINING_SEEDS}"),
        // 0 is no order at all.
        format!("run.shuffle={}", seed + 1),
        format!("gate.mode={gate}"),
        "learner.enabled=true".into(),
        format!("learner.algorithm={}", experiment.algorithm.word()),
        format!("learner.seed={seed}"),
        // A policy that learns may fail; the judge in the tick protects the car.
        "policy.shadow_ticks=0".into(),
        "policy.watch_ticks=0".into(),
        // The paper's cadence, and its answers at once.
        "gate.when=period".into(),
        "gate.dwell_s=0".into(),
        "gate.record=false".into(),
        // A process that waits for the controller waits for the learner with it.
        "limits.lockstep_wait_s=150.0".into(),
        // No tick waits on the wall: a learner that gets no processor on a busy
        // machine is late, not dead.
        "supervisor.silence_s=60.0".into(),
        format!("planner.method={}", experiment.expert.key()),
        // A teacher keeps more distance than a driver must, because a pupil does
        // not repeat it to the decimetre (results/learning.md): 0.6 m and 1.2 m are
        // what they drive with alone.
        "mpc.clearance_m=1.2".into(),
        "mpc.speed_mps=5.0".into(),
        "mpc.steps=8".into(),
        "informed.inflation_m=2.0".into(),
    ];
    if experiment.world == WorldChoice::Metadrive {
        keys.push("world.simulator=metadrive".into());
    }
    keys
}

#[cfg(test)]
mod tests {
    use shm_config::run::RunName;

    use super::*;

    #[test]
    fn a_long_folder_makes_a_name_that_a_run_can_have() {
        let name = run_name(Path::new("runs/an experiment of many words"), 17);
        assert!(name.ends_with("-17"), "{name}");
        assert!(name.parse::<RunName>().is_ok(), "{name}");
    }

    #[test]
    fn each_folder_has_a_name_of_its_own_and_keeps_it() {
        let place = tempfile::tempdir().expect("a folder");
        let out = place.path().join("p1/eyes56-t");
        let name = run_name(&out, 0);
        for other in ["p2/eyes56-t", "p1/eyes56-t2"] {
            assert_ne!(run_name(&place.path().join(other), 0), name, "{other}");
        }
        std::fs::create_dir_all(&out).expect("a folder");
        std::os::unix::fs::symlink(&out, place.path().join("link")).expect("a link");
        for same in ["p1/eyes56-t", "p1/eyes56-t/", "p1/../p1/eyes56-t", "link"] {
            assert_eq!(run_name(&place.path().join(same), 0), name, "{same}");
        }
    }
}
