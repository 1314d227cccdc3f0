//! The state of a recorded run at a tick, from which it is driven on.

use std::collections::{BTreeMap, BTreeSet};

use shm_config::config::Config;
use shm_config::message::{Observation, Plan, Step};

use super::course::Course;
use super::drive::Start;
use crate::replay::messages::taken;
use crate::replay::rebuild::{Mover, Rebuilt};
use controller::Recomputer;

/// Plans of the planner's memory that are made again: 2 s at the paper's 10 Hz. Its tracks
/// and its path are older than that only where they no longer matter.
const REMEMBERED: usize = 20;

/// The state at an observation of a course.
pub fn start(course: &Course, index: usize, rebuilt: &Rebuilt, config: &Config) -> Start {
    let observation = &course.messages.observations.all[index];
    let steps = &course.messages.steps.all;
    let is_before = |step: &Step| step.timings.planned_ns < observation.released_ns;
    let last = steps[..steps.partition_point(is_before)].last();
    let last = last.map(|step| {
        let mut recomputer = Recomputer::new(config);
        recomputer.recompute(step);
        (Box::new(*step), recomputer.after())
    });
    Start {
        rebuilt: rebuilt.clone(),
        observation: Box::new(*observation),
        last,
        planned: planned(course, observation),
    }
}

/// The states at several observations of a course; the world of each episode is rebuilt once.
///
/// # Errors
/// As [`Course::rebuild`].
pub fn starts(
    course: &Course,
    mover: &Mover,
    at: &BTreeSet<usize>,
) -> anyhow::Result<BTreeMap<usize, Start>> {
    let mut starts = BTreeMap::new();
    let mut next = at.first().copied();
    while let Some(index) = next {
        let first = course.beginning(index);
        let end = course.end_of_episode(first);
        let last = at.range(index..end).next_back().copied().unwrap_or(index);
        course.rebuild(mover, (first, last), |index, rebuilt| {
            if at.contains(&index) {
                starts.insert(index, start(course, index, rebuilt, &course.config));
            }
        })?;
        next = at.range(end..).next().copied();
    }
    Ok(starts)
}

/// The last plans of the episode before an observation, with what they answer.
fn planned(course: &Course, before: &Observation) -> Vec<(Observation, Plan)> {
    let plans = course.messages.plans.all.iter().rev();
    let earlier = plans.filter(|plan| {
        let header = &plan.header;
        header.episode == before.header.episode && header.taken_ns < before.header.taken_ns
    });
    let mut planned: Vec<_> = earlier
        .filter_map(|plan| {
            let observation = course.messages.observations.at(taken(&plan.header))?;
            Some((*observation, *plan))
        })
        .take(REMEMBERED)
        .collect();
    planned.reverse();
    planned
}
