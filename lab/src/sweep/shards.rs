//! Sweeps in parts. A piece is one training: a row and a seed.

use std::process::ExitCode;

use supervisor::subcommand::write_json_option;

use super::{Sweep, name, of_rows, read, rows, tell};
use crate::shard::Shard;
use crate::shard::folder::ShardWork;
use crate::shard::merge::{Merged, Partial, missing_parts, tell_other_training};
use crate::stop::Stop;
use crate::train::experiment::{self, Experiment};
use crate::train::results::{Results, Seed};
use crate::train::shards::{TrainingResult, terms, train_seed};
use stack::Clock;

/// The unit of the pieces.
const UNIT: &str = "training";

/// Does the trainings of a part that are left.
///
/// # Errors
/// If the part cannot be worked on, a training fails, or a stop is requested.
pub fn drive(arguments: &Sweep, shard: Shard, clock: Clock) -> anyhow::Result<()> {
    let stop = Stop::listen()?;
    let out = &arguments.out;
    let experiments: Vec<_> = rows()
        .map(|flawed| {
            let row = out.join(name(flawed));
            let train = arguments.of_row(flawed, false);
            Ok((Experiment::of_row(&train, out, &row)?, row))
        })
        .collect::<anyhow::Result<_>>()?;
    let Some((flawless, row)) = experiments.first() else {
        return Ok(());
    };
    let terms = terms("sweep", shard, flawless, row)?;
    let seeds = u64::from(arguments.seeds);
    let pieces = seeds * experiments.len() as u64;
    let label = arguments.algorithm.word();
    let mut work = ShardWork::open::<TrainingResult>(out, shard, &terms, (pieces, label))?;
    let of = |piece: u64| {
        let (experiment, row) = &experiments[(piece / seeds) as usize];
        let seed = experiment.seed.wrapping_add(piece % seeds);
        (experiment, (seed, row.as_path()))
    };
    work.redo_unless(|piece, result: &TrainingResult| {
        let (experiment, place) = of(piece);
        Ok(TrainingResult::of(experiment, place)?.as_ref() == Some(result))
    })?;
    if work.was_complete(UNIT) {
        return Ok(());
    }
    for piece in work.left().clone() {
        let (experiment, (seed, row)) = of(piece);
        let _lock = experiment::lock_shared(row)?;
        experiment.write(row)?;
        match train_seed(experiment, (seed, row), &stop, clock)? {
            Some(result) => work.keep(piece, &result)?,
            None => break,
        }
    }
    work.finish(UNIT)
}

/// Merges the parts in the folder. Exit code 1: something is missing.
///
/// # Errors
/// If the folder holds no part, or parts of different work.
pub fn report(arguments: &Sweep) -> anyhow::Result<ExitCode> {
    let out = &arguments.out;
    let merged = Merged::<TrainingResult>::read(out, "sweep")?;
    let terms = &merged.header.terms;
    let (first, seeds): (u64, u64) = (terms.number("--seed")?, terms.number("--seeds")?);
    let all: Vec<_> = rows().collect();
    merged.check_pieces(seeds.saturating_mul(all.len() as u64))?;
    let mut common = None;
    let mut trained: Vec<Vec<Seed>> = vec![Vec::new(); all.len()];
    let missing = merged.missing_unless(|piece, result| {
        let row = (piece / seeds) as usize;
        let (Some(&flawed), Some(trained)) = (all.get(row), trained.get_mut(row)) else {
            return Ok(false);
        };
        let (seed, folder) = (first.wrapping_add(piece % seeds), out.join(name(flawed)));
        let experiment = Experiment::read(&folder)?;
        let found = match &experiment {
            Some(experiment) => TrainingResult::of(experiment, (seed, &folder))?,
            None => None,
        };
        let folder = folder.join(format!("seed-{seed}"));
        if found.as_ref() != Some(result) {
            tell_other_training(&folder);
            return Ok(false);
        }
        common = common.take().or(experiment);
        trained.push(Seed::read(seed, folder)?);
        Ok(true)
    })?;
    let mut found = Vec::new();
    for (flawed, seeds) in all.into_iter().zip(trained) {
        let row = read(&Results { seeds }, flawed)?;
        if !row.trainings.is_empty() {
            found.push(row);
        }
    }
    let swept = common.map(|common| of_rows(found, &common)).transpose()?;
    if let Some(swept) = &swept {
        tell(swept, out)?;
    }
    let Some(missing) = missing_parts(&missing) else {
        write_json_option(&arguments.json, &swept)?;
        return Ok(ExitCode::SUCCESS);
    };
    missing.tell(&merged.header, UNIT);
    match &swept {
        Some(figures) => write_json_option(&arguments.json, &Partial { figures, missing })?,
        None => write_json_option(&arguments.json, &serde_json::json!({ "missing": missing }))?,
    }
    Ok(ExitCode::from(1))
}
