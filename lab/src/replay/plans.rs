//! The planner's plans, each recomputed from the recorded observation that it answers.
//!
//! RRT* and its kinodynamic form are functions of the observation. The informed RRT* and
//! model-predictive control remember the plans of an episode, which are recomputed in order.
//! A plan says whether it was late; that the solver reached its limit of time is told by a
//! plan without iterations. With `deadlines.planner = "skip"` the plans of a planner that
//! remembers are not recomputed, because late ones, which it remembers too, are not recorded.

use std::collections::HashMap;
use std::sync::Mutex;

use planner::Planner;
use rayon::prelude::*;
use shm_config::config::{Clock as RunClock, Config, Late, OutOfRange};
use shm_config::message::{Message, Plan};
use shm_config::services::Process;

use super::findings::{Findings, Found};
use super::messages::{Stretch, taken};

const PROCESS: Process = Process::Planner;
/// Plans that a thread recomputes at a time.
const CHUNK: usize = 32;

/// Recomputes the planner's plans.
pub struct Plans {
    config: Config,
    late: Late,
    remembers: bool,
    idle: Mutex<Vec<Planner>>,
    /// The planners with the memory of an episode, by process and episode.
    living: HashMap<(u32, u32), Planner>,
}

impl Plans {
    /// Of a run of this configuration.
    ///
    /// # Errors
    /// When the planner's configuration is out of range.
    pub fn new(config: &Config) -> Result<Self, OutOfRange> {
        let late = config.deadlines.planner;
        let mut config = config.clone();
        // The limit of time does not depend on this machine's speed.
        config.run.clock = RunClock::Lockstep;
        let planner = Planner::new(&config)?;
        Ok(Self {
            late,
            remembers: planner.remembers(),
            idle: Mutex::new(vec![planner]),
            living: HashMap::new(),
            config,
        })
    }

    /// Whether plans cannot be recomputed: plans that were not published changed the
    /// planner's memory.
    pub fn forgets(&self) -> bool {
        self.remembers && self.late == Late::Skip
    }

    /// Recomputes the plans of a stretch from this tick on.
    pub fn check(&mut self, stretch: &Stretch, from: u64, findings: &mut Findings) {
        let plans = &stretch.now.plans.all;
        if self.forgets() {
            findings.tally(PROCESS).unknown += plans.len() as u64;
            return;
        }
        let checked = match self.remembers {
            true => self.in_order(stretch, from),
            false => self.in_any_order(stretch, from),
        };
        for outcome in checked {
            match outcome {
                Outcome::Unknown => findings.unknown(PROCESS),
                Outcome::Equal => findings.count(PROCESS, 1),
                Outcome::Different(found) => {
                    findings.count(PROCESS, 1);
                    findings.add(PROCESS, Some(*found));
                }
                Outcome::Before => {}
            }
        }
    }

    fn in_any_order(&self, stretch: &Stretch, from: u64) -> Vec<Outcome> {
        let chunks = stretch.now.plans.all.par_chunks(CHUNK);
        let checked = chunks.map(|plans| {
            let Some(mut planner) = self.planner() else {
                return vec![Outcome::Unknown; plans.len()];
            };
            let wanted = |plan: &&Plan| plan.header.tick >= from;
            let check = |plan| self.again(&mut planner, stretch, plan);
            let checked = plans.iter().filter(wanted).map(check).collect();
            self.leave(planner);
            checked
        });
        checked.flatten_iter().collect()
    }

    /// The plans of each planner and episode in order; different ones at a time.
    fn in_order(&mut self, stretch: &Stretch, from: u64) -> Vec<Outcome> {
        let mut groups: HashMap<(u32, u32), Vec<&Plan>> = HashMap::new();
        for plan in &stretch.now.plans.all {
            let header = &plan.header;
            let group = groups.entry((header.producer, header.episode));
            group.or_default().push(plan);
        }
        // A planner goes on with an episode, or has begun another.
        let mut living = std::mem::take(&mut self.living);
        let groups: Vec<_> = groups
            .into_iter()
            .map(|(of, plans)| (of, plans, living.remove(&of)))
            .collect();
        let checked: Vec<_> = groups
            .into_par_iter()
            .map(|(of, plans, living)| {
                let planner = living.or_else(|| {
                    let mut planner = self.planner()?;
                    planner.forget();
                    Some(planner)
                });
                let Some(mut planner) = planner else {
                    return (of, None, vec![Outcome::Unknown; plans.len()]);
                };
                let check = |plan: &&Plan| match self.again(&mut planner, stretch, plan) {
                    // The memory needs it all the same.
                    _ if plan.header.tick < from => Outcome::Before,
                    outcome => outcome,
                };
                let checked = plans.iter().map(check).collect();
                (of, Some(planner), checked)
            })
            .collect();
        let last = stretch.now.plans.all.last();
        let last = last.map(|plan| (plan.header.producer, plan.header.episode));
        let mut outcomes = Vec::new();
        for (of, planner, checked) in checked {
            outcomes.extend(checked);
            match planner {
                Some(planner) if Some(of) == last => {
                    self.living.insert(of, planner);
                }
                Some(planner) => self.leave(planner),
                None => {}
            }
        }
        outcomes
    }

    fn again(&self, planner: &mut Planner, stretch: &Stretch, recorded: &Plan) -> Outcome {
        let at = taken(&recorded.header);
        let Some(observation) = stretch.find(|messages| messages.observations.at(at)) else {
            return Outcome::Unknown;
        };
        if let Err(refusal) = observation.check() {
            // The planner plans for no such observation.
            let at = (stretch.number, &recorded.header);
            let values = (refusal, "an observation that is admitted");
            let found = Found::new(PROCESS, at, "observation", values);
            return Outcome::Different(Box::new(found));
        }
        let mut again = Plan::default();
        planner.plan_again(observation, (recorded, self.late), &mut again);
        let found = Found::in_message(PROCESS, stretch.number, "plan", (recorded, &again));
        found.map_or(Outcome::Equal, |found| Outcome::Different(Box::new(found)))
    }

    fn planner(&self) -> Option<Planner> {
        let idle = self.idle.lock().ok().and_then(|mut idle| idle.pop());
        // The configuration was accepted before.
        idle.or_else(|| Planner::new(&self.config).ok())
    }

    fn leave(&self, planner: Planner) {
        if let Ok(mut idle) = self.idle.lock() {
            idle.push(planner);
        }
    }
}

/// What came of one plan.
#[derive(Clone)]
enum Outcome {
    /// It is before the first tick that was asked for.
    Before,
    /// Its observation is not recorded.
    Unknown,
    /// All bytes are equal.
    Equal,
    /// A field differs.
    Different(Box<Found>),
}
