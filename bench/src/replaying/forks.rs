//! Forks of the recordings.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::{Context, bail};
use lab::fork::course::{Course, Until};
use lab::fork::drive::{Drive, Wheel};
use lab::fork::start::starts;
use lab::fork::{mode_with_policy, read_policy, unchanged::Unchanged as Loop, with_policies};
use lab::replay::rebuild::Mover;
use lab::replay::recorded::Recorded;
use serde::Serialize;
use shm_config::draw::Draw;
use stack::Clock;

use super::recordings::Recordings;
use super::{BenchReplay, in_parallel};

/// Observations at a recording's end at which no fork begins.
const LAST: usize = 20;

/// Forks without a change.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Unchanged {
    /// All of them.
    pub forks: u64,
    /// Those that are the recording, bit by bit, to its end.
    pub identical: u64,
    /// Ticks that they drove.
    pub ticks: u64,
    /// Time of all, s.
    pub elapsed_s: f64,
}

/// Forks with another policy.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Drives {
    /// All of them.
    pub forks: u64,
    /// Time that they drove, s; an episode may end before its time is up.
    pub driven_s: f64,
    /// Time of all, from the reading of the recordings on, s.
    pub elapsed_s: f64,
    /// Forks per minute.
    pub forks_per_minute: f64,
}

/// Drives each recording on from a random tick, and compares it to its end.
pub(super) fn unchanged(recordings: &Recordings, clock: Clock) -> anyhow::Result<Unchanged> {
    let begun = clock();
    let name = ("fork without a change", "forks");
    let driven = in_parallel(name, recordings.files(), clock, |path| {
        fork_once(path, clock).with_context(|| path.display().to_string())
    })?;
    Ok(Unchanged {
        forks: driven.len() as u64,
        identical: driven.iter().filter(|(same, _)| *same).count() as u64,
        ticks: driven.iter().map(|(_, ticks)| ticks).sum(),
        elapsed_s: clock().since_ns(begun) as f64 * 1e-9,
    })
}

/// The place of a recording among others.
fn number(path: &Path) -> u64 {
    let folder = path.parent().and_then(Path::file_name);
    let name = folder.and_then(|name| name.to_str());
    name.and_then(|name| name.parse().ok()).unwrap_or_default()
}

/// Whether a fork at a random tick is the recording, and the ticks that it drove.
fn fork_once(path: &Path, clock: Clock) -> anyhow::Result<(bool, u64)> {
    let mut recorded = Recorded::open(path)?;
    let mut course = Course::read(&mut recorded, 0, Until::End)?;
    let places = course.messages.observations.all.len().saturating_sub(LAST);
    course.at = Draw::new(number(path)).below(places as u64) as usize;
    let mover = Mover::new(&course.config);
    let first = course.beginning(course.at);
    let rebuilt = course.rebuild(&mover, (first, course.at), |_, _| {})?;
    let (recomputer, missing) = with_policies(&course, &mut recorded, clock)?;
    if let Some(hash) = missing.first() {
        bail!("the policy {hash:016x} is not in the recording");
    }
    let mut own = Loop::new(&course, &mover, recomputer)?;
    own.drive(rebuilt)?;
    Ok((own.difference.is_none(), own.ticks))
}

/// Drives many forks on with another policy.
pub(super) fn drives(
    arguments: &BenchReplay,
    recordings: &Recordings,
    clock: Clock,
) -> anyhow::Result<Drives> {
    let files = recordings.files();
    let begun = clock();
    let wanted = |path: &Path| {
        let (all, number) = (files.len() as u64, number(path));
        let more = u64::from(number < arguments.drives % all);
        arguments.drives / all + more
    };
    let name = ("fork with another policy", "recordings");
    let driven = in_parallel(name, files, clock, |path| {
        let forks = Forks {
            policy: recordings.policy(),
            seconds: arguments.seconds,
            count: wanted(path),
            clock,
        };
        forks
            .drive(path)
            .with_context(|| path.display().to_string())
    })?;
    let elapsed_s = clock().since_ns(begun) as f64 * 1e-9;
    let forks = driven.iter().map(|(forks, _)| forks).sum::<u64>();
    Ok(Drives {
        forks,
        driven_s: driven.iter().map(|(_, seconds)| seconds).sum(),
        elapsed_s,
        forks_per_minute: forks as f64 / elapsed_s.max(1e-9) * 60.0,
    })
}

/// The forks of one recording.
struct Forks<'a> {
    policy: &'a Path,
    seconds: f64,
    count: u64,
    clock: Clock,
}

impl Forks<'_> {
    /// How many were driven, and for how long together, s. The world is rebuilt once.
    fn drive(&self, path: &Path) -> anyhow::Result<(u64, f64)> {
        if self.count == 0 {
            return Ok((0, 0.0));
        }
        let course = Course::read(&mut Recorded::open(path)?, 0, Until::End)?;
        let mut config = course.config.clone();
        config.gate.mode = mode_with_policy(config.gate.mode);
        let mover = Mover::new(&course.config);
        let places = course.messages.observations.all.len().saturating_sub(LAST) as u64;
        let mut draw = Draw::new(!number(path));
        let mut at = BTreeSet::new();
        while (at.len() as u64) < self.count.min(places) {
            at.insert(draw.below(places) as usize);
        }
        let mut driven_s = 0.0;
        let starts = starts(&course, &mover, &at)?;
        let forks = starts.len() as u64;
        for start in starts.into_values() {
            let drive = Drive {
                config: &config,
                mover: &mover,
                seconds: self.seconds,
                clock: self.clock,
            };
            let policy = read_policy(self.policy, &config, self.clock)?;
            let driven = drive.run(start, Wheel::Stack(Some(policy)))?;
            driven_s += driven.ticks as f64 * config.run.period_ns() as f64 * 1e-9;
        }
        Ok((forks, driven_s))
    }
}
