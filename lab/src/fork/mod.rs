//! `./vlaps fork`: a recorded run, driven on in a closed loop from any tick.
//!
//! | module | holds |
//! |---|---|
//! | [`course`] | the recorded episode, and its world rebuilt up to the tick |
//! | [`unchanged`] | without a change: the recording's own timing, compared bit by bit |
//! | [`start`], [`drive`] | with a change: the state at the tick, and the drive from there |

pub mod course;
pub mod drive;
pub mod start;
pub mod unchanged;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, bail};
use clap::Args;
use controller::{Policy, Recomputer};
use serde::Serialize;
use shm_config::config::{Config, GateMode, planner::Method};
use shm_config::counted;
use shm_config::message::{Driver, Episode, Reason, WEIGHTS_BYTES_MAX};
use stack::Clock;
use stack::driver::DriverKind;
use supervisor::cli::failure::Failure;
use supervisor::show::summary::{EpisodeRow, Share};
use supervisor::subcommand::{Output, Subcommand, say, seconds, write_json_option};

use crate::replay::command::changed;
use crate::replay::findings::Difference;
use crate::replay::rebuild::Mover;
use crate::replay::recorded::Recorded;
use crate::replay::source::{PolicyBytes, Source};
use crate::replay::ticks::build;
use crate::replay::worlds::is_built_in;
use crate::report::hex;
use course::{Course, Until};
use drive::{Drive, Driven, Wheel, share};
use unchanged::Unchanged;

/// Drive on from a recorded tick: with another policy, planner, judge or setting.
#[derive(Debug, Args)]
#[command(
    after_help = "The built-in world is a function of its seed and of the commands: it is rebuilt \
        from the recorded ones up to the tick and compared with every recorded observation on \
        the way. From there the stack drives in a closed loop. Without a change the instants \
        at which it reads and sends are the recorded ones, and the result is the recording, \
        bit by bit, to its end. With a change it drives in lockstep to the end of the \
        episode; exact geometry answers in place of a model, and no person takes over.\n\n\
        Exit code: 0, it drove; 1, without a change it was not the recording; 2, the world \
        cannot be rebuilt.\n\n\
        Examples:\n  \
        ./vlaps fork runs/default/recording --tick 400\n  \
        ./vlaps fork REC --tick 400 --policy policy.onnx --json fork.json\n  \
        ./vlaps fork REC --tick 400 --driver mpc --seconds 10\n  \
        ./vlaps fork REC --tick 400 --set gate.mode=rules --set gate.period_s=1"
)]
pub struct Fork {
    /// The recording: a folder with MCAP files of one run, or one file.
    #[arg(value_name = "REC")]
    pub recording: PathBuf,
    /// Drive on from this tick.
    #[arg(long, value_name = "N")]
    pub tick: u64,
    /// With the policy of this file; where the run's gate asks no judge, it drives alone.
    #[arg(long, value_name = "FILE")]
    pub policy: Option<PathBuf>,
    /// With another planner, rrt-star, informed, kinodynamic or mpc; or a driver of its own:
    /// expert, lane, idm.
    #[arg(long, value_name = "DRIVER")]
    pub driver: Option<DriverKind>,
    /// With another setting, such as gate.mode=rules; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Drive on for so long at most, s.
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub seconds: Option<f64>,
    /// Write the figures to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// The figures of a fork; those after the blank line as `./vlaps up --json` has them.
#[derive(Debug, Serialize)]
struct Figures {
    /// Whether it is the recording bit by bit; `None` when something was changed.
    identical: Option<bool>,
    /// Where it first differs.
    first_difference: Option<Difference>,
    /// The tick from which it was driven on.
    tick: u64,
    /// Ticks with contact since then.
    contacts: Option<u64>,

    episodes: Vec<EpisodeRow>,
    ticks: u64,
    elapsed_s: f64,
    period_s: f64,
    command_digest: Option<String>,
    share: Share,
    reasons: BTreeMap<&'static str, BTreeMap<&'static str, u64>>,
}

impl Subcommand for Fork {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::json(&self.json)]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let figures = self.drive(clock).map_err(cannot)?;
        tell(&figures);
        write_json_option(&self.json, &figures)?;
        Ok(match figures.identical {
            Some(false) => ExitCode::from(1),
            Some(true) | None => ExitCode::SUCCESS,
        })
    }
}

/// An error with the exit code of a command that could not run.
pub fn cannot(error: anyhow::Error) -> anyhow::Error {
    match error.downcast::<Failure>() {
        Ok(failure) => failure.into(),
        Err(other) => Failure::Usage(format!("{other:#}")).into(),
    }
}

impl Fork {
    fn is_changed(&self) -> bool {
        self.policy.is_some()
            || self.driver.is_some()
            || !self.overrides.is_empty()
            || self.seconds.is_some()
    }

    fn drive(&self, clock: Clock) -> anyhow::Result<Figures> {
        if self.policy.is_some() && self.driver.is_some_and(|kind| kind.method().is_none()) {
            bail!("--policy and a --driver that drives alone: give one of them");
        }
        let mut recorded = Recorded::open(&self.recording)?;
        if !is_built_in(recorded.config()) {
            bail!("the recorded world is not the built-in one, and cannot be rebuilt");
        }
        let until = match self.is_changed() {
            true => Until::Episode,
            false => Until::End,
        };
        let course = Course::read(&mut recorded, self.tick, until)?;
        match self.is_changed() {
            false => unchanged(&course, &mut recorded, clock),
            true => {
                let config = self.config(&recorded)?;
                let policy = match &self.policy {
                    Some(file) => Some(read_policy(file, &config, clock)?),
                    None => recorded_policy(&course, &mut recorded, clock)?,
                };
                let wheel = match self.driver {
                    Some(kind) if kind.method().is_none() && kind != DriverKind::Expert => {
                        Wheel::Driver(kind)
                    }
                    _ => Wheel::Stack(policy),
                };
                self.changed(&course, &config, wheel, clock)
            }
        }
    }

    /// The recorded configuration with the changes.
    fn config(&self, recorded: &Recorded) -> anyhow::Result<Config> {
        let method = self.driver.and_then(DriverKind::method);
        let mut config = changed_in_loop(recorded, method, &self.overrides, self.policy.is_some())?;
        if self.driver == Some(DriverKind::Expert) {
            config.gate.mode = GateMode::Expert;
        }
        Ok(config)
    }

    fn changed(
        &self,
        course: &Course,
        config: &Config,
        wheel: Wheel,
        clock: Clock,
    ) -> anyhow::Result<Figures> {
        let mover = Mover::new(&course.config);
        let first = course.beginning(course.at);
        let rebuilt = course.rebuild(&mover, (first, course.at), |_, _| {})?;
        let start = start::start(course, course.at, &rebuilt, &course.config);
        let drive = Drive {
            config,
            mover: &mover,
            seconds: self.seconds.unwrap_or(f64::INFINITY),
            clock,
        };
        let tick = course.observation().header.tick;
        let driven = drive.run(start, wheel)?;
        Ok(Figures::of(config, tick, &driven))
    }
}

/// The recorded configuration with another planner and other settings for a closed loop. A
/// new policy may drive, unless the settings say who does.
///
/// # Errors
/// When a setting is wrong, or is one of the recorded world.
pub fn changed_in_loop(
    recorded: &Recorded,
    method: Option<Method>,
    overrides: &[String],
    has_new_policy: bool,
) -> anyhow::Result<Config> {
    let keys = || {
        overrides
            .iter()
            .map(|text| text.split('=').next().unwrap_or_default().trim())
    };
    let is_fixed = |key: &&str| key.starts_with("world.") || key.starts_with("run.");
    if let Some(key) = keys().find(is_fixed) {
        bail!("--set {key}: the recorded world is rebuilt, and {key} remains as recorded");
    }
    let mut config = changed(recorded, method, overrides)?;
    if has_new_policy && !keys().any(|key| key == "gate.mode") {
        config.gate.mode = mode_with_policy(config.gate.mode);
    }
    Ok(config)
}

/// Which driver drives when a policy is given: it, where the run has a judge or none.
pub fn mode_with_policy(mode: GateMode) -> GateMode {
    match mode {
        GateMode::Expert | GateMode::Human => GateMode::Policy,
        other => other,
    }
}

/// A recomputer with the policies of a course's steps, and the hashes of those that are not in
/// the recording.
///
/// # Errors
/// When a policy cannot be read or is refused.
pub fn with_policies(
    course: &Course,
    source: &mut dyn Source,
    clock: Clock,
) -> anyhow::Result<(Recomputer, Vec<u64>)> {
    let mut hashes: Vec<u64> = (course.messages.steps.all.iter())
        .flat_map(|step| [step.weights_hash, step.shadow.weights_hash])
        .filter(|hash| *hash != 0)
        .collect();
    hashes.sort_unstable();
    hashes.dedup();
    let (mut policies, mut missing) = (Vec::new(), Vec::new());
    for hash in hashes {
        match source.policy(hash)? {
            Some(policy) => policies.push(build(&policy, &course.config, clock)?),
            None => missing.push(hash),
        }
    }
    let recomputer = Recomputer::with_policies(&course.config, policies);
    Ok((recomputer, missing))
}

fn unchanged(course: &Course, recorded: &mut Recorded, clock: Clock) -> anyhow::Result<Figures> {
    let config = &course.config;
    let mover = Mover::new(config);
    let first = course.beginning(course.at);
    let rebuilt = course.rebuild(&mover, (first, course.at), |_, _| {})?;
    let (recomputer, missing) = with_policies(course, recorded, clock)?;
    for hash in missing {
        say(format_args!(
            "note: the policy {hash:016x} is not in the recording; its proposals are taken as \
             recorded"
        ));
    }
    let mut own = Unchanged::new(course, &mover, recomputer)?;
    let ended = own.drive(rebuilt)?;
    let all = &course.messages.observations.all;
    let (begun, last) = (course.observation(), &all[all.len() - 1]);
    let episodes = course.messages.episodes.all.iter();
    let rows: Vec<EpisodeRow> = episodes.map(row).collect();
    Ok(Figures {
        identical: Some(own.difference.is_none()),
        first_difference: own.difference.clone(),
        tick: begun.header.tick,
        contacts: None,
        episodes: rows,
        ticks: own.ticks,
        elapsed_s: last.header.taken_ns.saturating_sub(begun.header.taken_ns) as f64 * 1e-9,
        period_s: config.run.period_ns() as f64 * 1e-9,
        command_digest: Some(hex(&ended.score.digest())),
        share: own.share(),
        reasons: words(&own.reasons),
    })
}

impl Figures {
    fn of(config: &Config, tick: u64, driven: &Driven) -> Self {
        let period_s = config.run.period_ns() as f64 * 1e-9;
        let share = |driver| share(driven, driver);
        Self {
            identical: None,
            first_difference: None,
            tick,
            contacts: Some(driven.contacts),
            episodes: vec![row(&driven.episode)],
            ticks: driven.ticks,
            elapsed_s: driven.ticks as f64 * period_s,
            period_s,
            command_digest: Some(hex(&driven.episode.command_digest)),
            share: Share {
                expert: share(Driver::Expert),
                policy: share(Driver::Policy),
                brake: share(Driver::Brake),
            },
            reasons: words(&driven.reasons),
        }
    }
}

/// Ticks by the words of driver and reason.
fn words(
    reasons: &BTreeMap<(u32, u32), u64>,
) -> BTreeMap<&'static str, BTreeMap<&'static str, u64>> {
    let mut words: BTreeMap<_, BTreeMap<_, u64>> = BTreeMap::new();
    for ((driver, reason), count) in reasons {
        let driver = Driver::from_code(*driver).unwrap_or(Driver::Brake).word();
        let reason = Reason::from_code(*reason).map_or("unknown", Reason::word);
        *words.entry(driver).or_default().entry(reason).or_default() += count;
    }
    words
}

fn row(episode: &Episode) -> EpisodeRow {
    EpisodeRow {
        seed: episode.seed,
        outcome: episode.outcome().word(),
        strict: episode.is_strict_success(),
        completion: episode.completion,
        ticks: episode.ticks,
    }
}

/// A policy of a file.
///
/// # Errors
/// When it cannot be read or is refused.
pub fn read_policy(file: &Path, config: &Config, clock: Clock) -> anyhow::Result<Box<dyn Policy>> {
    let name = || file.display().to_string();
    let bytes = shm_config::file::read(file, WEIGHTS_BYTES_MAX as u64).with_context(name)?;
    build(&PolicyBytes { hash: 0, bytes }, config, clock).with_context(name)
}

/// The policy that was active at the fork.
fn recorded_policy(
    course: &Course,
    recorded: &mut Recorded,
    clock: Clock,
) -> anyhow::Result<Option<Box<dyn Policy>>> {
    let released_ns = course.observation().released_ns;
    let mut before = course.messages.steps.all.iter().rev();
    let last = before.find(|step| step.timings.planned_ns < released_ns);
    let Some(hash) = last.map(|step| step.weights_hash).filter(|hash| *hash != 0) else {
        return Ok(None);
    };
    match recorded.policy(hash)? {
        Some(policy) => Ok(Some(build(&policy, &course.config, clock)?)),
        None => bail!("the policy {hash:016x} is not in the recording; name one with --policy"),
    }
}

fn tell(figures: &Figures) {
    match (&figures.identical, &figures.first_difference) {
        (Some(true), _) => say("it is the recording, bit by bit, to its end"),
        (_, Some(first)) => say(format_args!(
            "it differs from the recording: tick {}, {}, {}: recorded {}, driven {}",
            first.tick, first.process, first.field, first.recorded, first.recomputed
        )),
        (_, None) => {}
    }
    for episode in &figures.episodes {
        say(format_args!(
            "seed {}: {}, {:.1} % of the route, {}",
            episode.seed,
            episode.outcome,
            100.0 * episode.completion,
            counted(episode.ticks, "tick")
        ));
    }
    if let Some(contacts) = figures.contacts {
        say(format_args!(
            "{} with contact since the fork",
            counted(contacts, "tick")
        ));
    }
    let share = &figures.share;
    say(format_args!(
        "{} from tick {}: expert {:.1} %, policy {:.1} %, brake {:.1} %",
        counted(figures.ticks, "tick"),
        figures.tick,
        100.0 * share.expert,
        100.0 * share.policy,
        100.0 * share.brake
    ));
}
