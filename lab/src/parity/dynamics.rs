//! Compares the car's dynamics: step responses on a straight road, and windows of recorded
//! drives at any speed, each starting from the recorded state.

use std::path::Path;

use anyhow::{Context, bail};
use sim::dynamics::{Car, Motion, SUBSTEP_S};
use sim::model::{Forces, VehicleKind};
use vehicle::{Action, Vector, pose};

use super::record::{Rollout, step_responses};
use super::{LOOKS, Row, Unit};

/// Number of ticks over which step responses are compared, and the limit of the median
/// position error of their rows, m.
const RESPONSE: (usize, f64) = LOOKS[1];
/// A window begins every second. Its first second is warm-up, so that the suspension
/// reaches its recorded state; it lasts as long as the last comparison, ticks.
const EVERY: usize = 10;
const WARM_UP: usize = 10;
const WINDOW: usize = LOOKS[2].0;

/// Compares every recorded row of the first 3 s of each step response; no rows without
/// a recording. Cars that slide have the largest errors.
pub(super) fn response_rows(folder: &Path) -> anyhow::Result<Vec<Row>> {
    let Some(record) = step_responses(folder)? else {
        return Ok(Vec::new());
    };
    let params = record.params.first().context("no car of the responses")?;
    let car = Car::new(
        VehicleKind::Default,
        Forces {
            engine_n: params.max_engine_force,
            brake: params.max_brake_force,
        },
    );
    let (ticks, bar_m) = RESPONSE;
    let mut errors_m = Vec::new();
    for (name, rows) in &record.responses {
        let (action, speed_mps) = meaning(name)?;
        let mut motion = Motion::at_rest(pose(5.0, 7.0, 0.0), car.model)
            .with_velocity(Vector::new(speed_mps, 0.0), 0.0);
        for &[x, y, ..] in rows.iter().take(ticks) {
            car.tick(&mut motion, action);
            let seen = motion.seen_position();
            errors_m.push((seen.x - x).hypot(seen.y - y));
        }
    }
    let what = format!("step responses: position within {} s", ticks / 10);
    Ok(vec![
        Row::typical(&what, &mut errors_m, (Unit::M, 0.5), Some(bar_m)),
        Row::typical(&what, &mut errors_m, (Unit::M, 0.9), None),
    ])
}

/// The held action and the initial speed, m/s, from a name such as `steer_0.1_v15.0`,
/// `brake_-0.5_from20`, `throttle_0.2` or `coast_20`.
fn meaning(name: &str) -> anyhow::Result<(Action, f64)> {
    let mut words = name.split('_');
    let kind = words.next().unwrap_or_default();
    let mut number = || -> anyhow::Result<f64> {
        let Some(word) = words.next() else {
            return Ok(0.0);
        };
        let digits = word.trim_start_matches(|c: char| c.is_alphabetic());
        digits.parse().with_context(|| format!("response {name}"))
    };
    let (steer, pedal, speed_mps) = match kind {
        "steer" => (number()?, 0.0, number()?),
        "coast" => (0.0, 0.0, number()?),
        "throttle" | "brake" => (0.0, number()?, number()?),
        _ => bail!("response {name}: of which action?"),
    };
    Ok((Action { steer, pedal }, speed_mps))
}

/// Compares all windows of all drives of a kind; `forces` returns those of a seed's car.
pub(super) fn window_rows(
    kind: &str,
    rollouts: &[Rollout],
    forces: impl Fn(u64) -> Option<Forces>,
) -> anyhow::Result<Vec<Row>> {
    let mut errors_m: [Vec<f64>; 3] = Default::default();
    for rollout in rollouts {
        let seed = rollout.seed;
        let forces = forces(seed).with_context(|| format!("seed {seed} has no scenario"))?;
        replay(
            &Car::new(VehicleKind::Default, forces),
            rollout,
            &mut errors_m,
        );
    }
    let mut rows = Vec::new();
    for ((ticks, bar_m), errors_m) in LOOKS.into_iter().zip(&mut errors_m) {
        let what = format!("{kind} windows: position after {} s", ticks / 10);
        rows.push(Row::typical(&what, errors_m, (Unit::M, 0.5), Some(bar_m)));
        rows.push(Row::typical(&what, errors_m, (Unit::M, 0.9), None));
    }
    Ok(rows)
}

fn replay(car: &Car, rollout: &Rollout, errors_m: &mut [Vec<f64>; 3]) {
    let contact = |tick: usize| rollout.judged[tick].touched() || rollout.judged[tick].sidewalk;
    let action = |tick: usize| {
        let [steer, pedal] = rollout.actions[tick];
        Action { steer, pedal }
    };
    // The recorded pose is that of one sub-step before.
    let place = |tick: usize| {
        let ego = &rollout.ego[tick];
        let velocity = Vector::new(ego.velocity[0], ego.velocity[1]);
        let ahead = velocity * SUBSTEP_S;
        let turned_rad = ego.heading_rad + ego.yaw_rate_radps * SUBSTEP_S;
        let at = pose(
            ego.position[0] + ahead.x,
            ego.position[1] + ahead.y,
            turned_rad,
        );
        (at, velocity, ego.yaw_rate_radps)
    };
    let last = rollout.actions.len().saturating_sub(WINDOW);
    for start in (WARM_UP..last).step_by(EVERY) {
        if (start - WARM_UP..start + WINDOW).any(contact) {
            continue;
        }
        let (at, velocity, yaw_rate_radps) = place(start - WARM_UP);
        let mut motion = Motion::settled(at, car).with_velocity(velocity, yaw_rate_radps);
        for tick in start - WARM_UP..start {
            car.tick(&mut motion, action(tick));
        }
        let (at, velocity, yaw_rate_radps) = place(start);
        motion = motion.moved_to(at).with_velocity(velocity, yaw_rate_radps);
        for tick in 0..WINDOW {
            car.tick(&mut motion, action(start + tick));
            let Some(look) = LOOKS.iter().position(|&(ticks, _)| ticks == tick + 1) else {
                continue;
            };
            let [x, y] = rollout.ego[start + tick + 1].position;
            let seen = motion.seen_position();
            errors_m[look].push((seen.x - x).hypot(seen.y - y));
        }
    }
}
