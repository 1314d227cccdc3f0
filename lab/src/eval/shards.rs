//! Evaluations in parts. A piece is an episode.

use std::path::Path;
use std::process::ExitCode;

use anyhow::Context;
use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
use shm_config::config::{Config, Simulator};
use shm_config::counted;
use shm_config::message::{Episode, Outcome};
use stack::Clock;
use stack::driver::DriverKind;
use supervisor::setup::foreign::Foreign;
use supervisor::subcommand::{say, write_json_option};

use super::{Compared, Eval, compare, print};
use crate::episodes::{DrivenEpisode, Drives, Task, evaluate_seeds};
use crate::evaluation::Evaluation;
use crate::outcomes::WorldSettings;
use crate::outside;
use crate::progress::Progress;
use crate::report::hex;
use crate::shard::folder::ShardWork;
use crate::shard::merge::{Merged, Partial};
use crate::shard::terms::Terms;
use crate::shard::{Shard, exact};
use crate::stop::Stop;
use stack::driver::planning_histogram;

/// The unit of the pieces.
const UNIT: &str = "episode";
/// Number of progress lines of a part.
const PARTS: u64 = 20;

/// A finished episode in the file of a part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct EpisodeResult {
    seed: u64,
    ticks: u64,
    #[serde(with = "exact")]
    completion: f64,
    #[serde(with = "exact")]
    driven_m: f64,
    vehicle_contacts: u64,
    object_contacts: u64,
    /// The code of an outcome.
    outcome: u32,
    crash_last_step: u32,
    /// SHA-256 of all commands, hexadecimal.
    command_digest: String,
    /// Planning times by their bucket in the histogram: us, number of plans.
    planning_us: Vec<(u64, u64)>,
}

impl EpisodeResult {
    fn of(driven: &DrivenEpisode) -> EpisodeResult {
        let episode = &driven.episode;
        let times = driven.planning_us.iter();
        EpisodeResult {
            seed: episode.seed,
            ticks: episode.ticks,
            completion: episode.completion,
            driven_m: episode.driven_m,
            vehicle_contacts: episode.vehicle_contacts,
            object_contacts: episode.object_contacts,
            outcome: episode.outcome,
            crash_last_step: episode.crash_last_step,
            command_digest: hex(&episode.command_digest),
            planning_us: times
                .flat_map(|times| times.iter_recorded())
                .map(|of| (of.value_iterated_to(), of.count_since_last_iteration()))
                .collect(),
        }
    }

    /// Whether it can be the result of this piece.
    fn is_of(&self, piece: u64, first_seed: u64) -> bool {
        self.seed == first_seed.wrapping_add(piece) && Outcome::from_code(self.outcome).is_some()
    }

    /// The episode with the fields that figures are computed from.
    fn driven(&self) -> DrivenEpisode {
        let mut times: Histogram<u64> = planning_histogram();
        for (us, count) in &self.planning_us {
            times.saturating_record_n(*us, *count);
        }
        let episode = Episode {
            seed: self.seed,
            ticks: self.ticks,
            completion: self.completion,
            driven_m: self.driven_m,
            vehicle_contacts: self.vehicle_contacts,
            object_contacts: self.object_contacts,
            outcome: self.outcome,
            crash_last_step: self.crash_last_step,
            ..Episode::default()
        };
        DrivenEpisode {
            episode,
            planning_us: (!times.is_empty()).then_some(times),
        }
    }
}

/// Drives the episodes of a part that are left.
///
/// # Errors
/// If the part cannot be worked on, an episode cannot be driven, or a stop is requested.
pub fn drive(
    arguments: &Eval,
    (shard, out): (Shard, &Path),
    (task, config): (&Task, &Config),
    clock: Clock,
) -> anyhow::Result<()> {
    let terms = terms(arguments, shard, config)?;
    let label = task.driver.word();
    let mut work = ShardWork::open::<EpisodeResult>(out, shard, &terms, (task.episodes, label))?;
    work.redo_unless(|piece, result: &EpisodeResult| Ok(result.is_of(piece, task.first_seed)))?;
    if work.was_complete(UNIT) {
        return Ok(());
    }
    let (done, total) = work.progress();
    let name = format!("shard {shard}");
    let mut progress = Progress::begin(name, "episodes", (done, total), clock)?;
    let left: Vec<u64> = work.left().iter().copied().collect();
    let part = total.div_ceil(PARTS);
    let mut keep = |driven: DrivenEpisode| {
        let piece = driven.episode.seed.wrapping_sub(task.first_seed);
        work.keep(piece, &EpisodeResult::of(&driven))?;
        let (done, total) = work.progress();
        if done.is_multiple_of(part) || done == total {
            progress.at(done);
        }
        Ok(())
    };
    let driven = match task.world {
        Simulator::BuiltIn => {
            let stop = Stop::listen()?;
            let seed = |piece: &u64| task.first_seed.wrapping_add(*piece);
            let seeds: Vec<u64> = left.iter().map(seed).collect();
            evaluate_seeds((task, &seeds), config, (clock, &stop), &mut keep)
        }
        _ => runs(&left).into_iter().try_for_each(|(first, episodes)| {
            let task = Task {
                first_seed: task.first_seed.wrapping_add(first),
                episodes,
                ..task.clone()
            };
            outside::evaluate(&task, config, clock, &mut keep)
        }),
    };
    progress.end();
    driven?;
    work.finish(UNIT)
}

/// Consecutive pieces: the first, and their number. A world in a process of its own drives
/// consecutive seeds.
fn runs(pieces: &[u64]) -> Vec<(u64, u64)> {
    let mut runs: Vec<(u64, u64)> = Vec::new();
    for &piece in pieces {
        match runs.last_mut() {
            Some((first, count)) if *first + *count == piece => *count += 1,
            _ => runs.push((piece, 1)),
        }
    }
    runs
}

fn terms(arguments: &Eval, shard: Shard, config: &Config) -> anyhow::Result<Terms> {
    let mut terms = Terms::new("eval", shard);
    match arguments.driver {
        DriverKind::Policy(file) => terms.add_content("--driver", file.as_ref())?,
        named => terms.add("--driver", named.word()),
    }
    terms.add("--world", arguments.world.word());
    terms.add("--first-seed", arguments.first_seed);
    terms.add("--episodes", arguments.episodes);
    terms.add_config(config)?;
    Ok(terms)
}

/// Merges the parts in the folder: the figures of one piece where all are there. Exit code
/// 1: something is missing.
///
/// # Errors
/// If the folder holds no part, or parts of different work.
pub fn report(arguments: &Eval, out: &Path) -> anyhow::Result<ExitCode> {
    let mut merged = Merged::<EpisodeResult>::read(out, "eval")?;
    let terms = &merged.header.terms;
    let driver: DriverKind = (merged.header.label.parse()).map_err(anyhow::Error::msg)?;
    let first_seed = terms.number("--first-seed")?;
    let world = terms.get("--world")?;
    let world: Simulator = serde_json::from_value(world.into()).context("--world of the shards")?;
    merged.check_pieces(terms.number("--episodes")?)?;
    merged.results.retain(|piece, result| {
        let is_right = result.is_of(*piece, first_seed);
        if !is_right {
            let (seed, outcome) = (result.seed, result.outcome);
            say(format_args!(
                "piece {piece} cannot be used (seed {seed}, outcome {outcome}), counted as missing"
            ));
        }
        is_right
    });
    let mut drives = Drives::none();
    // By seed, as an evaluation in one piece has them.
    for result in merged.results.values() {
        drives.add(result.driven())?;
    }
    drives.episodes.sort_by_key(|episode| episode.seed);
    let episodes = drives.episodes.len() as u64;
    let task = |episodes| Task {
        driver,
        world,
        first_seed,
        episodes,
        threads: std::num::NonZeroUsize::MIN,
    };
    // The terms of another build may have other settings.
    let section = merged.header.terms.section("world").ok();
    let settings = section.and_then(|section| WorldSettings::of(&section, world));
    let earlier = arguments.earlier(&task(merged.header.pieces), &settings)?;
    let task = task(episodes);
    let evaluation = Evaluation::new(&task, settings, &drives);
    let last_seed = task.first_seed.wrapping_add(merged.header.pieces - 1);
    say(format_args!(
        "{} in {}, seeds {first_seed} to {last_seed}: {} of {} of {}",
        driver.word(),
        Foreign::name_of(world),
        episodes,
        counted(merged.header.pieces, UNIT),
        counted(merged.header.of, "shard"),
    ));
    print(&evaluation);
    let Some(missing) = merged.missing() else {
        let figures = &evaluation;
        let compared = earlier.map(|earlier| compare(earlier, figures));
        let against = compared.transpose()?;
        write_json_option(&arguments.json, &Compared { figures, against })?;
        return Ok(ExitCode::SUCCESS);
    };
    missing.tell(&merged.header, UNIT);
    if earlier.is_some() {
        say("not compared with --against: parts are missing");
    }
    let figures = &evaluation;
    write_json_option(&arguments.json, &Partial { figures, missing })?;
    Ok(ExitCode::from(1))
}

#[cfg(test)]
mod tests {
    use super::runs;

    #[test]
    fn consecutive_pieces_are_one_run() {
        assert_eq!(runs(&[]), []);
        assert_eq!(runs(&[3, 4, 5, 9, 11, 12]), [(3, 3), (9, 1), (11, 2)]);
    }
}
