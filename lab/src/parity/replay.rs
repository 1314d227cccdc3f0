//! Drives recorded actions again, open loop, and compares the car's position and the
//! observations with the recording.

use anyhow::{Context, ensure};
use shm_config::message::{BEAMS_MAX, Observation};
use sim::World;
use vehicle::Action;

use super::record::Rollout;
use super::{LOOKS, Row, Unit};

/// Number of ticks over which observations are compared.
const TICKS: usize = LOOKS[2].0;

/// Errors of all drives of a kind.
#[derive(Default)]
struct Errors {
    /// Position errors at each of [`LOOKS`], m.
    away_m: [Vec<f64>; 3],
    /// The largest feature error of each tick.
    feature: Vec<f64>,
    /// The same without the lidar beams.
    own_feature: Vec<f64>,
}

/// Replays all drives of a kind.
pub(super) fn rows(
    kind: &str,
    rollouts: &[Rollout],
    world: &mut World,
) -> anyhow::Result<Vec<Row>> {
    let mut errors = Errors::default();
    for rollout in rollouts {
        let seed = rollout.seed;
        replay(world, rollout, &mut errors).with_context(|| format!("{kind} drive {seed}"))?;
    }
    let mut rows = Vec::new();
    for ((ticks, bar_m), away_m) in LOOKS.into_iter().zip(&mut errors.away_m) {
        let what = format!("{kind} drives: position after {} s", ticks / 10);
        rows.push(Row::typical(&what, away_m, (Unit::M, 0.5), Some(bar_m)));
        rows.push(Row::typical(&what, away_m, (Unit::M, 0.9), None));
    }
    for (name, found) in [
        ("worst feature of a tick", &mut errors.feature),
        ("worst of the 19 without beams", &mut errors.own_feature),
    ] {
        let what = format!("{kind} drives: {name}");
        rows.push(Row::typical(&what, found, (Unit::Feature, 0.5), None));
        rows.push(Row::typical(&what, found, (Unit::Feature, 0.9), None));
    }
    Ok(rows)
}

/// Replays one recording up to the first contact in either world: what follows a contact
/// is chaotic in both.
fn replay(world: &mut World, rollout: &Rollout, errors: &mut Errors) -> anyhow::Result<()> {
    world.reset(rollout.seed)?;
    let mut observation = Observation::default();
    let mut room = [0.0; 19 + BEAMS_MAX];
    for (tick, &[steer, pedal]) in rollout.actions.iter().enumerate().take(TICKS) {
        let touch = world.step(Action { steer, pedal }).touch;
        if rollout.judged[tick].touched() || touch.vehicle || touch.object {
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
            let [x, y] = rollout.ego[tick + 1].position;
            let ego = world.ego_position();
            errors.away_m[look].push((ego.x - x).hypot(ego.y - y));
        }
    }
    Ok(())
}
