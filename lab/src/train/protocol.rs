//! The experiment's numbers, as the configuration of a run.

use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use anyhow::bail;
use shm_config::config::{Algorithm, Config, Simulator, load};
use shm_config::run::{RunName, name_max};
use supervisor::cli::failure::Failure;
use toml::{Table, Value};

use super::experiment::Experiment;
use super::results::CONFIG;
use crate::actors::drive::in_lockstep;
use crate::sections::{DECISIVE, EPISODES, WAITS};
use supervisor::subcommand::settings;

/// First training seed; the seeds are 100 to 149.
const TRAINING_SEED: u64 = 100;
/// Number of training seeds.
const TRAINING_SEEDS: u32 = 50;
/// First evaluation seed; the seeds are 1000 to 1049.
pub const EVALUATION_SEED: u64 = 1000;
/// First seed of the evaluation that is made once, at the very end: no setting was chosen
/// with a look at it.
pub const HELD_BACK_SEED: u64 = 50_000;
/// Duration of a step, s.
pub const STEP_S: f64 = 0.1;

/// One training of the experiment.
#[derive(Clone, Debug)]
pub struct Protocol {
    /// Seed of the training.
    pub seed: u64,
    /// Folder of the training.
    pub folder: PathBuf,
    /// Number of training steps.
    pub steps: u64,
    /// Number of evaluation episodes after each block.
    pub episodes: u64,
    /// Actors on this machine; `None` if a process set drives.
    pub actors: Option<u32>,
    /// Where actors of other machines join, and the run that has invited them.
    pub actors_at: Option<(String, Option<RunName>)>,
    /// Configuration of the run, without its duration.
    pub config: Config,
}

impl Protocol {
    /// The training of a seed.
    ///
    /// # Errors
    /// If the configuration or an override is invalid.
    pub fn new(experiment: &Experiment, (seed, out): (u64, &Path)) -> anyhow::Result<Protocol> {
        check_own(&experiment.set)?;
        let folder = out.join(format!("seed-{seed}"));
        let files = [experiment.config.as_deref(), None];
        let asked = settings::config(files, &experiment.set)?;
        let mut overrides = preset(experiment, seed);
        // A policy that sees one scan cannot imitate an expert that slows down for how others
        // move; one that is told it gains from it, but with pvp (results/learning.md).
        let is_wary = asked.learner.motion && experiment.algorithm != Algorithm::Pvp;
        overrides.push(format!("mpc.wary={is_wary}"));
        overrides.push(format!("run.name={}", run_name(out, seed)));
        overrides.extend(experiment.set.iter().cloned());
        let mut config = settings::config(files, &overrides)?;
        config.run.folder = folder.display().to_string();
        let block_steps = u64::from(config.learner.block_steps);
        if !experiment.steps.is_multiple_of(block_steps) {
            let message = format!(
                "--steps {}: must be a multiple of learner.block_steps, {block_steps}",
                experiment.steps
            );
            return Err(Failure::Usage(message).into());
        }
        let run = experiment.actors_run.as_deref();
        let run = run
            .map(str::parse)
            .transpose()
            .map_err(anyhow::Error::new)?;
        let protocol = Protocol {
            seed,
            folder,
            steps: experiment.steps,
            episodes: experiment.eval_episodes,
            actors: experiment.actors,
            actors_at: experiment.actors_at.clone().map(|address| (address, run)),
            config,
        };
        if protocol.actors.is_some() {
            in_lockstep(&protocol.config)?;
        }
        protocol.check_same()?;
        Ok(protocol)
    }

    /// The configuration file of the training's process set.
    pub fn file(&self) -> PathBuf {
        self.folder.join(CONFIG)
    }

    /// Checks that a resumed training has the configuration with which it began, as far as that
    /// affects learning.
    fn check_same(&self) -> anyhow::Result<()> {
        let file = self.file();
        if !file.exists() {
            return Ok(());
        }
        let mut begun = load(&file)?;
        // The policy may have another name where the old one is gone: the training was moved.
        let named = &mut begun.policy.file;
        if !named.is_empty() && !Path::new(named).exists() {
            named.clone_from(&self.config.policy.file);
        }
        let begun = Table::try_from(begun)?;
        let now = Table::try_from(&self.config)?;
        let mut differences = Vec::new();
        for section in DECISIVE {
            compare(
                section,
                begun.get(section),
                now.get(section),
                &mut differences,
            );
        }
        for key in EPISODES {
            let [begun, now] = [&begun, &now].map(|table| table.get("run")?.get(key));
            compare(&format!("run.{key}"), begun, now, &mut differences);
        }
        if !differences.is_empty() {
            bail!(
                "{}: the training began with other options: {}; leave these out, or give the \
                 same values; --out DIR begins another experiment",
                file.display(),
                differences.join(", ")
            );
        }
        Ok(())
    }
}

/// Collects the keys with different values, as `key = begun, not now`.
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
        && !WAITS.contains(&key)
    {
        out.push(format!("{key} = {begun}, not {now}"));
    }
}

/// Keys that a training sets itself, with the reason or the option to use instead.
const OWN: [(&str, &str); 6] = [
    ("run.clock", "a training drives in lockstep"),
    ("run.duration_s", "--steps says how long it drives"),
    ("run.folder", "--out names the folder"),
    ("learner.enabled", "a training always learns"),
    ("learner.algorithm", "--algorithm says how it learns"),
    ("learner.seed", "--seed and --seeds say it"),
];

/// Refuses overrides of keys that a training sets itself. A configuration file may contain
/// them for other commands.
fn check_own(overrides: &[String]) -> Result<(), Failure> {
    for text in overrides {
        if let Some((_, instead)) = OWN.iter().find(|(own, _)| *own == settings::key(text)) {
            return Err(Failure::Usage(format!(
                "--set {text}: ./vlaps train sets this key itself: {instead}"
            )));
        }
    }
    Ok(())
}

/// A run name made of the folder's name (shortened), a checksum of its whole path, and the
/// seed: experiments in folders of the same name can run at the same time.
pub(super) fn run_name(out: &Path, seed: u64) -> String {
    let out = whole(out);
    let folder = out.file_name().unwrap_or_default().to_string_lossy();
    let name = folder.chars().map(|c| match c.is_ascii_alphanumeric() {
        true => c,
        false => '-',
    });
    // Six hexadecimal digits: two folders collide with a probability of 1 in 17 million.
    let sum = crc32c::crc32c(out.as_os_str().as_bytes()) & 0xff_ffff;
    let end = format!("-{sum:06x}-{seed}");
    let letters = name_max().saturating_sub(end.len());
    name.take(letters).chain(end.chars()).collect()
}

/// A folder's canonical path; the same before and after the folder is created.
fn whole(folder: &Path) -> PathBuf {
    let path = std::path::absolute(folder).unwrap_or_else(|_| folder.into());
    let found = path.ancestors().find_map(|there| {
        let rest = path.strip_prefix(there).ok()?;
        Some(there.canonicalize().ok()?.join(rest))
    });
    // Without a trailing slash.
    found.unwrap_or(path).components().collect()
}

/// What `pvp` has beyond PVP4Real's settings; results/learning.md shows what each brings.
/// Batch and updates are PVP4Real's.
const PVP: [&str; 8] = [
    "learner.batch=1024",
    "learner.updates=200",
    "learner.critic_steer=5",
    "learner.critic_pedal=2",
    "learner.target_noise=0.05",
    "learner.imitation_weight=10",
    "learner.imitation_steer=10",
    "learner.averaged=true",
];

/// The experiment's settings; the user's overrides follow them.
fn preset(experiment: &Experiment, seed: u64) -> Vec<String> {
    let gate = match experiment.algorithm {
        // Behaviour cloning learns from the expert's driving alone.
        Algorithm::Bc => "expert",
        // As in PVP4Real, on whose experiment the paper builds: a label every 10 s, which the
        // paper's text names, does not teach it (results/learning.md).
        Algorithm::Pvp => "takeover",
        Algorithm::Ppl | Algorithm::HgDagger | Algorithm::Dagger => "rules",
    };
    let mut keys = vec![
        format!("run.seed={TRAINING_SEED}"),
        format!("run.seeds={TRAINING_SEEDS}"),
        // 0 means no shuffling.
        format!("run.shuffle={}", seed + 1),
        format!("gate.mode={gate}"),
        "learner.enabled=true".into(),
        format!("learner.algorithm={}", experiment.algorithm.word()),
        format!("learner.seed={seed}"),
        // A policy in training may fail; the safety check protects the car.
        "policy.shadow_ticks=0".into(),
        "policy.watch_ticks=0".into(),
        // The paper's interval of questions, answered immediately.
        "gate.when=period".into(),
        "gate.dwell_s=0".into(),
        "gate.record=false".into(),
        // Processes that wait for the controller thereby wait for the learner, too.
        "limits.lockstep_wait_s=600.0".into(),
        // Steps that are driven meanwhile would not be learnt from: with an eighth of a
        // core a block takes more than two minutes.
        "limits.learner_wait_s=480.0".into(),
        // In lockstep a silent process is slow, not dead: the learner may get no processor
        // time on a busy machine.
        "supervisor.silence_s=60.0".into(),
        format!("planner.method={}", experiment.expert.key()),
        // The teacher keeps a larger distance than it does alone (0.6 m and 1.2 m), because the
        // policy reproduces it with an error of decimetres (results/learning.md).
        "mpc.clearance_m=1.2".into(),
        "mpc.speed_mps=5.0".into(),
        "mpc.steps=8".into(),
        "informed.inflation_m=2.0".into(),
    ];
    if experiment.algorithm == Algorithm::Pvp {
        keys.extend(PVP.map(String::from));
    }
    if experiment.world == Simulator::MetaDrive {
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
    fn a_training_goes_on_with_the_limits_and_episodes_it_began_with() {
        let place = tempfile::tempdir().expect("a folder");
        let open = |set: &str| {
            let experiment = Experiment {
                set: set.split(' ').map(String::from).collect(),
                ..Experiment::default()
            };
            Protocol::new(&experiment, (0, place.path()))
        };
        let begun = open("run.seeds=20").expect("a training");
        std::fs::create_dir_all(&begun.folder).expect("a folder");
        let mut config = begun.config.clone();
        // As a process set that continued has it.
        config.run.shuffle += 400;
        config.run.duration_s = 40.0;
        let text = toml::to_string(&config).expect("text");
        std::fs::write(begun.file(), text).expect("written");
        let limits = &begun.config.limits;
        assert!(
            limits.lockstep_wait_s > limits.learner_wait_s,
            "who waits for the controller waits for the learner"
        );
        for same in [
            "run.seeds=20",
            "run.seeds=20 limits.lockstep_wait_s=300 limits.learner_wait_s=200",
        ] {
            assert!(open(same).is_ok(), "{same}");
        }
        for (other, hint) in [
            ("run.seeds=40", "run.seeds = 20, not 40"),
            ("run.seeds=20 run.seed=7", "run.seed = 100, not 7"),
            (
                "run.seeds=20 limits.command_age_ms=400",
                "limits.command_age_ms",
            ),
            ("run.seeds=20 deadlines.planner=skip", "deadlines.planner"),
        ] {
            let error = open(other).expect_err(other).to_string();
            assert!(error.contains(hint), "{other}: {error}");
        }
    }

    #[test]
    fn only_a_policy_that_is_gone_may_have_another_name() {
        let place = tempfile::tempdir().expect("a folder");
        let (old, new) = (place.path().join("old.onnx"), place.path().join("new.onnx"));
        let out = place.path().join("out");
        let open = |file: &Path| {
            let experiment = Experiment {
                set: vec![format!("policy.file={}", file.display())],
                ..Experiment::default()
            };
            Protocol::new(&experiment, (0, &out))
        };
        let begin = |file: &Path| {
            let _ = std::fs::remove_dir_all(&out);
            let begun = open(file).expect("a training");
            std::fs::create_dir_all(&begun.folder).expect("a folder");
            let text = toml::to_string(&begun.config).expect("text");
            std::fs::write(begun.file(), text).expect("written");
        };
        for (first, there) in [(old.as_path(), false), (&old, true), (Path::new(""), true)] {
            begin(first);
            if there {
                std::fs::write(&old, "").expect("written");
            }
            let error = open(&new).err().map(|error| error.to_string());
            let is_refused = error.is_some_and(|error| error.contains("policy.file = "));
            assert_eq!(is_refused, there, "{first:?}");
        }
    }

    #[test]
    fn the_expert_is_wary_where_the_policy_is_told_how_others_move() {
        let place = tempfile::tempdir().expect("a folder");
        for (algorithm, set, is_wary) in [
            (Algorithm::Ppl, "run.seeds=20", false),
            (Algorithm::Ppl, "learner.motion=true", true),
            (Algorithm::Ppl, "learner.motion=true mpc.wary=false", false),
            (Algorithm::Pvp, "learner.motion=true", false),
            (Algorithm::Pvp, "mpc.wary=true", true),
        ] {
            let experiment = Experiment {
                algorithm,
                set: set.split(' ').map(String::from).collect(),
                ..Experiment::default()
            };
            let protocol = Protocol::new(&experiment, (0, place.path())).expect("a training");
            assert_eq!(protocol.config.mpc.wary, is_wary, "{algorithm:?} {set}");
        }
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
