//! Recorded actions driven again, open loop: how far the car then is from
//! where it was, and how different what it sees.

use std::path::Path;

use anyhow::{Context, ensure};
use shm_config::message::{BEAMS_MAX, Observation};
use sim::World;
use vehicle::Action;

use super::record::Rollout;
use super::{Row, Unit};
use crate::statistics::quantile;

/// After how many ticks to look, and how far from the record the median drive
/// may be by then, m.
const LOOKS: [(usize, f64); 3] = [(10, 0.1), (30, 0.5), (50, 1.5)];
/// So far the observations are compared, ticks.
const TICKS: usize = LOOKS[2].0;

/// Errors over all drives of a kind.
#[derive(Default)]
struct Errors {
    /// At each of [`LOOKS`], m.
    away_m: [Vec<f64>; 3],
    /// The largest feature error of each tick.
    feature: Vec<f64>,
    /// The same without the beams.
    own_feature: Vec<f64>,
}

/// Replays all drives of a kind; also returns how many there are.
pub(super) fn rows(
    folder: &Path,
    kind: &str,
    world: &mut World,
) -> anyhow::Result<(Vec<Row>, usize)> {
    let rollouts = Rollout::read_all(folder, kind)?;
    let mut errors = Errors::default();
    for rollout in &rollouts {
        let seed = rollout.seed;
        replay(world, rollout, &mut errors).with_context(|| format!("{kind} drive {seed}"))?;
    }
    let mut rows = Vec::new();
    for ((ticks, bar_m), away_m) in LOOKS.into_iter().zip(&mut errors.away_m) {
        let what = format!("{kind} drives: position after {} s", ticks / 10);
        rows.push(typical(&what, away_m, (Unit::M, 0.5), Some(bar_m)));
        rows.push(typical(&what, away_m, (Unit::M, 0.9), None));
    }
    for (name, found) in [
        ("worst feature of a tick", &mut errors.feature),
        ("worst of the 19 without beams", &mut errors.own_feature),
    ] {
        let what = format!("{kind} drives: {name}");
        rows.push(typical(&what, found, (Unit::Feature, 0.5), None));
        rows.push(typical(&what, found, (Unit::Feature, 0.9), None));
    }
    Ok((rows, rollouts.len()))
}

/// A row of a quantile of many errors.
fn typical(what: &str, errors: &mut [f64], (unit, share): (Unit, f64), bar: Option<f64>) -> Row {
    let error = quantile(errors, share);
    let over = |bar: f64| errors.iter().filter(|error| **error > bar).count();
    Row {
        what: what.into(),
        compared: errors.len(),
        different: bar.map_or(0, over),
        error,
        unit,
        figure: if share == 0.5 { "median" } else { "p90" },
        bar,
        // NaN, of no drives at all, meets nothing.
        met: bar.map(|bar| error <= bar),
    }
}

/// Drives one record up to the first contact, the record's or ours: what
/// follows one is a matter of luck on both sides.
fn replay(world: &mut World, rollout: &Rollout, errors: &mut Errors) -> anyhow::Result<()> {
    world.reset(rollout.seed)?;
    let mut observation = Observation::default();
    let mut room = [0.0; 19 + BEAMS_MAX];
    for (tick, &[steer, pedal]) in rollout.actions.iter().enumerate().take(TICKS) {
        let touch = world.step(Action { steer, pedal }).touch;
        if rollout.touched[tick] || touch.vehicle || touch.object {
            return Ok(());
        }
        world.observe(&mut observation);
        let features = observation.features(&mut room).context("too many beams")?;
        let recorded = &rollout.features[tick + 1];
        let (theirs, ours) = (recorded.len(), features.len());
        ensure!(theirs == ours, "{theirs} features recorded, {ours} here");
        let apart = recorded
            .iter()
            .zip(features)
            .map(|(a, b)| f64::from((a - b).abs()));
        let worst = |apart: &mut dyn Iterator<Item = f64>| apart.fold(0.0, f64::max);
        errors.own_feature.push(worst(&mut apart.clone().take(19)));
        errors.feature.push(worst(&mut apart.clone()));
        let look = LOOKS.iter().position(|&(ticks, _)| ticks == tick + 1);
        if let Some(look) = look {
            let [x, y] = rollout.positions[tick + 1];
            let ego = world.ego_position();
            errors.away_m[look].push((ego.x - x).hypot(ego.y - y));
        }
    }
    Ok(())
}
