//! The built-in world's observations, progress and episodes, recomputed from the seed and
//! the commands that were applied.

use std::collections::BTreeMap;

use rayon::prelude::*;
use shm_config::config::Config;
use shm_config::layout::Layout;
use shm_config::message::{Episode, Observation, Outcome};
use shm_config::services::Process;
use shm_config::{Message, RunGrid};

use super::findings::{Findings, Found};
use super::messages::{Stretch, taken};
use super::rebuild::{Astray, Mover, Rebuilt, Sent, observe, progress};

const PROCESS: Process = Process::World;

/// A world's process and its episode.
type Of = (u32, u32);

/// Recomputes what the built-in world published.
pub struct Worlds {
    mover: Mover,
    config: Config,
    /// Worlds whose episodes go on.
    living: BTreeMap<Of, Rebuilt>,
}

/// The messages of one episode in a stretch.
#[derive(Default)]
struct Part<'a> {
    observations: Vec<&'a Observation>,
    end: Option<&'a Episode>,
    living: Option<Rebuilt>,
}

/// What came of a part.
struct Done {
    of: Of,
    living: Option<Rebuilt>,
    found: Vec<Found>,
    recomputed: u64,
    unknown: u64,
}

impl Worlds {
    /// Of a run of this configuration.
    pub fn new(config: &Config) -> Self {
        Self {
            mover: Mover::new(config),
            config: config.clone(),
            living: BTreeMap::new(),
        }
    }

    /// Recomputes a stretch; differences before this tick are not kept.
    pub fn check(&mut self, stretch: &Stretch, from: u64, findings: &mut Findings) {
        let mut parts: BTreeMap<Of, Part> = BTreeMap::new();
        for (of, living) in std::mem::take(&mut self.living) {
            parts.entry(of).or_default().living = Some(living);
        }
        for observation in &stretch.now.observations.all {
            let header = &observation.header;
            let part = parts.entry((header.producer, header.episode));
            part.or_default().observations.push(observation);
        }
        for episode in &stretch.now.episodes.all {
            let header = &episode.header;
            let part = parts.entry((header.producer, header.episode));
            part.or_default().end = Some(episode);
        }
        let [before, after] = stretch.beside;
        let near = before.steps.all.iter().chain(&stretch.now.steps.all);
        let sent = Sent::new(near.chain(&after.steps.all));
        let done: Vec<Done> = parts
            .into_par_iter()
            .map(|(of, part)| self.part((stretch, from), &sent, of, part))
            .collect();
        for done in done {
            findings.count(PROCESS, done.recomputed as usize);
            findings.tally(PROCESS).unknown += done.unknown;
            findings.add(PROCESS, done.found);
            if let Some(living) = done.living {
                self.living.insert(done.of, living);
            }
        }
    }

    fn part(&self, (stretch, from): (&Stretch, u64), sent: &Sent, of: Of, part: Part) -> Done {
        let mut done = Done {
            of,
            living: part.living,
            found: Vec::new(),
            recomputed: 0,
            unknown: 0,
        };
        for recorded in part.observations {
            let is_wanted = recorded.header.tick >= from;
            let before = done.found.len();
            match self.observation(stretch, sent, &mut done.living, recorded) {
                Some(found) => {
                    done.recomputed += u64::from(is_wanted);
                    done.found.extend(found);
                }
                None => done.unknown += u64::from(is_wanted),
            }
            if !is_wanted {
                done.found.truncate(before);
            }
        }
        let end = part.end.filter(|_| done.living.is_some());
        if let (Some(recorded), Some(living)) = (end, done.living.take_if(|_| end.is_some())) {
            let (_, again) = self.mover.end(&living, recorded, sent);
            let pair = (recorded, &again);
            let found = Found::in_message(PROCESS, stretch.number, "episode", pair);
            done.found
                .extend(found.filter(|_| recorded.header.tick >= from));
            done.recomputed += 1;
        }
        done
    }

    /// The first difference in an observation; `None` when the world could not be moved
    /// there.
    fn observation(
        &self,
        stretch: &Stretch,
        sent: &Sent,
        living: &mut Option<Rebuilt>,
        recorded: &Observation,
    ) -> Option<Option<Found>> {
        let at = (stretch.number, &recorded.header);
        let told = stretch.find(|messages| messages.progress.at(taken(&recorded.header)));
        let again = match living {
            Some(rebuilt) => {
                let braked = told.map(|progress| progress.braked);
                match self.mover.follow(rebuilt, (recorded, braked), sent) {
                    Ok(again) => again,
                    Err(Astray::Gap) => {
                        *living = None;
                        return None;
                    }
                    Err(Astray::NoCommand { newest }) => {
                        *living = None;
                        let ego = &recorded.ego;
                        let said = |steer: f64, pedal: f64| format!("steer {steer}, pedal {pedal}");
                        let newest = newest.map_or("no command".into(), |newest| {
                            format!("{} of the newest command", said(newest.steer, newest.pedal))
                        });
                        let values = (said(ego.steer, ego.pedal), newest);
                        let field = "observation.ego.steer";
                        return Some(Some(Found::new(PROCESS, at, field, values)));
                    }
                }
            }
            None if is_first(stretch, recorded) => {
                let world = self.mover.world().ok()?;
                let rebuilt = self.mover.begin(world, recorded).ok()?;
                let again = observe(&rebuilt, recorded);
                *living = Some(rebuilt);
                again
            }
            None => return None,
        };
        let differs = Found::in_message(PROCESS, stretch.number, "observation", (recorded, &again));
        let found = differs
            .or_else(|| self.instants(stretch.number, recorded))
            .or_else(|| {
                let (rebuilt, recorded) = (living.as_ref()?, told?);
                if recorded.outcome != Outcome::Driving.code() {
                    return None;
                }
                let again = progress(rebuilt, recorded);
                let same = again.as_bytes() == recorded.as_bytes();
                let pair = (recorded, &again);
                (!same).then(|| Found::in_message(PROCESS, stretch.number, "progress", pair))?
            });
        Some(found)
    }

    /// The instants of an observation, of which each is in another one, too.
    fn instants(&self, stretch: u64, recorded: &Observation) -> Option<Found> {
        let (header, at) = (&recorded.header, (stretch, &recorded.header));
        let taken_ns = header.taken_ns;
        if self.config.run.is_lockstep() {
            let period_ns = self.config.run.period_ns();
            let is_of_tick = taken_ns / period_ns == header.tick;
            let due = format!("in tick {}", header.tick);
            return (!is_of_tick)
                .then(|| Found::new(PROCESS, at, "observation.header.taken_ns", (taken_ns, due)));
        }
        if taken_ns != recorded.released_ns {
            let values = (taken_ns, recorded.released_ns);
            let field = "observation.header.taken_ns";
            return Some(Found::new(PROCESS, at, field, values));
        }
        let grid = RunGrid::of(&self.config);
        let now = shm_config::Instant(taken_ns);
        let refused = grid.admit(recorded, now).err()?;
        let values = (recorded.scheduled_ns, refused.to_string());
        Some(Found::new(PROCESS, at, "observation.scheduled_ns", values))
    }
}

/// Whether an observation is the first of its episode.
fn is_first(stretch: &Stretch, recorded: &Observation) -> bool {
    let header = recorded.header();
    let before = (header.producer, header.sequence.wrapping_sub(1));
    let previous = stretch.find(|messages| messages.observations.find(before));
    match previous {
        Some(previous) => previous.header.episode != header.episode,
        None => header.sequence == 1,
    }
}

/// Whether the run's world can be recomputed: it is the built-in one.
pub fn is_built_in(config: &Config) -> bool {
    config.has_built_in_world()
}
