//! A fork without a change: world, planner and controller in a closed loop, with the
//! instants at which each read and sent taken from the recording.
//!
//! Taken from it are: which observation, plan, advice and takeover a tick had and when;
//! which command the world applied at which instant, skipped instants and brakes on silence;
//! the answers of a judge and of a person. The contents of observations, plans and commands
//! are the loop's own.

use std::collections::{BTreeMap, HashMap};

use anyhow::Context;
use controller::Recomputer;
use planner::Planner;
use shm_config::config::Clock as RunClock;
use shm_config::difference::first_difference;
use shm_config::layout::Layout;
use shm_config::message::{Command, Driver, Lateness, Message, Observation, Plan, Step};

use supervisor::show::summary::Share;

use super::course::Course;
use crate::replay::findings::Difference;
use crate::replay::messages::{Key, Taken, key, taken};
use crate::replay::rebuild::{Applied, Mover, Rebuilt, observe};

/// The loop, and how far it is.
pub struct Unchanged<'a> {
    course: &'a Course,
    mover: &'a Mover,
    planner: Planner,
    /// The planner's process: another one remembers nothing.
    planner_of: Option<u32>,
    recomputer: Recomputer,
    /// The next recorded step, and the next recorded plan.
    step: usize,
    plan: usize,
    observations: HashMap<Key, Observation>,
    observations_by_time: HashMap<Taken, Key>,
    plans: HashMap<Key, Plan>,
    commands: HashMap<Key, Command>,
    last: Option<Step>,
    /// The first difference to the recording.
    pub difference: Option<Difference>,
    /// Ticks of the controller that were driven.
    pub ticks: u64,
    /// Those by driver and reason.
    pub reasons: BTreeMap<(u32, u32), u64>,
}

impl<'a> Unchanged<'a> {
    /// The loop from the fork's observation on; `recomputer` has the run's policies.
    ///
    /// # Errors
    /// When the planner's configuration is out of range.
    pub fn new(
        course: &'a Course,
        mover: &'a Mover,
        recomputer: Recomputer,
    ) -> anyhow::Result<Unchanged<'a>> {
        let mut config = course.config.clone();
        config.run.clock = RunClock::Lockstep;
        let planner = Planner::new(&config).context("the planner")?;
        let released_ns = course.observation().released_ns;
        let taken_ns = course.observation().header.taken_ns;
        let episode = course.observation().header.episode;
        let steps = &course.messages.steps.all;
        let is_before = |step: &Step| step.timings.planned_ns < released_ns;
        let step = steps.partition_point(is_before);
        let plans = &course.messages.plans.all;
        let is_earlier = |plan: &&Plan| {
            plan.header.episode < episode
                || (plan.header.episode == episode && plan.header.taken_ns < taken_ns)
        };
        let plan = plans.iter().take_while(is_earlier).count();
        let mut begun = Self {
            course,
            mover,
            planner,
            planner_of: None,
            recomputer,
            step,
            plan: 0,
            observations: HashMap::new(),
            observations_by_time: HashMap::new(),
            plans: HashMap::new(),
            commands: HashMap::new(),
            last: None,
            difference: None,
            ticks: 0,
            reasons: BTreeMap::new(),
        };
        if begun.planner.remembers() {
            (0..plan).for_each(|index| begun.make_plan(index));
        }
        begun.plan = plan;
        Ok(begun)
    }

    /// Drives on from a world at the fork's observation to the end of what was read.
    ///
    /// # Errors
    /// When a world cannot be moved or begun.
    pub fn drive(&mut self, mut rebuilt: Rebuilt) -> anyhow::Result<Rebuilt> {
        let all = &self.course.messages.observations.all;
        self.observed(self.course.at, observe(&rebuilt, &all[self.course.at]));
        for index in self.course.at + 1..all.len() {
            let (before, recorded) = (&all[index - 1].header, &all[index]);
            let header = recorded.header;
            let goes_on = (before.producer, before.episode) == (header.producer, header.episode);
            let again = match goes_on {
                true => self.follow(&mut rebuilt, recorded)?,
                false => {
                    self.end(&mut rebuilt);
                    let begun = self.mover.begin(rebuilt.world, recorded);
                    rebuilt = begun.with_context(|| format!("tick {}", header.tick))?;
                    observe(&rebuilt, recorded)
                }
            };
            self.observed(index, again);
        }
        while self.step < self.course.messages.steps.all.len() {
            self.tick();
        }
        self.end(&mut rebuilt);
        Ok(rebuilt)
    }

    /// Moves the world with the loop's own command in place of the recorded one.
    fn follow(
        &mut self,
        rebuilt: &mut Rebuilt,
        recorded: &Observation,
    ) -> anyhow::Result<Box<Observation>> {
        let told = self.course.messages.progress.at(taken(&recorded.header));
        let braked = told.map(|progress| progress.braked);
        let (index, applied) = self
            .mover
            .identify(rebuilt, (recorded, braked), &self.course.sent)
            .map_err(|astray| anyhow::anyhow!("tick {}: {astray}", recorded.header.tick))?;
        let own = self.own(applied);
        self.mover.advance(rebuilt, index, &own);
        rebuilt.header = recorded.header;
        Ok(observe(rebuilt, recorded))
    }

    /// The loop's own command of the number of a recorded one.
    fn own(&mut self, applied: Applied) -> Applied {
        let Applied::Command(recorded) = applied else {
            return applied;
        };
        let wanted = key(&recorded.header);
        let steps = &self.course.messages.steps.all;
        let known = |step: &Step| is_sent(step) && key(&step.command.header) == wanted;
        if let Some(ahead) = steps[self.step..].iter().position(known) {
            (0..=ahead).for_each(|_| self.tick());
        }
        // Before the fork the loop's commands are the recorded ones.
        let own = self.commands.get(&wanted).copied();
        Applied::Command(own.unwrap_or(recorded))
    }

    /// Ends an episode as the recording does.
    fn end(&mut self, rebuilt: &mut Rebuilt) {
        let header = rebuilt.header;
        let episodes = self.course.messages.episodes.all.iter();
        let mut of_world = episodes.filter(|episode| episode.header.producer == header.producer);
        let Some(recorded) = of_world.find(|end| end.header.episode == header.episode) else {
            // The recording ends within it.
            return;
        };
        let own = |command: &Command| self.commands.get(&key(&command.header)).copied();
        let (ended, again) = self
            .mover
            .end_with(rebuilt, recorded, &self.course.sent, own);
        self.compare("world", "episode", recorded, &again);
        *rebuilt = ended;
    }

    fn observed(&mut self, index: usize, again: Box<Observation>) {
        let recorded = &self.course.messages.observations.all[index];
        self.compare("world", "observation", recorded, &again);
        let key = key(&again.header);
        self.observations_by_time.insert(taken(&again.header), key);
        self.observations.insert(key, *again);
    }

    /// The controller's next tick.
    fn tick(&mut self) {
        let recorded = &self.course.messages.steps.all[self.step];
        self.step += 1;
        self.make_plans(key(&recorded.plan.header));
        let mut own = *recorded;
        let is_next = |last: &&Step| {
            let (before, now) = (&last.header, &recorded.header);
            before.producer == now.producer && before.sequence.wrapping_add(1) == now.sequence
        };
        if self.last.as_ref().filter(is_next).is_some() {
            own.before = self.recomputer.after();
        }
        if let Some(observation) = self.observations.get(&key(&own.observation.header)) {
            own.observation = *observation;
        }
        if let Some(plan) = self.plans.get(&key(&own.plan.header)) {
            own.plan = *plan;
        }
        let step = *self.recomputer.recompute(&own);
        self.compare("controller", "", recorded, &step);
        self.commands
            .insert(key(&step.command.header), step.command);
        self.last = Some(step);
        self.ticks += 1;
        let drove = (step.command.driver, step.command.reason);
        *self.reasons.entry(drove).or_default() += 1;
    }

    /// Makes the plans up to the one of this number, which a tick reads.
    fn make_plans(&mut self, wanted: Key) {
        let plans = &self.course.messages.plans.all;
        let is_wanted = |plan: &Plan| key(&plan.header) == wanted;
        let Some(ahead) = plans[self.plan..].iter().position(is_wanted) else {
            return;
        };
        for index in self.plan..=self.plan + ahead {
            self.make_plan(index);
        }
        self.plan += ahead + 1;
    }

    fn make_plan(&mut self, index: usize) {
        let recorded = &self.course.messages.plans.all[index];
        let at = taken(&recorded.header);
        let own = self.observations_by_time.get(&at);
        let own = own.and_then(|key| self.observations.get(key));
        let Some(observation) = own.or_else(|| self.course.messages.observations.at(at)) else {
            return;
        };
        let producer = recorded.header.producer;
        if self.planner_of.replace(producer) != Some(producer) {
            self.planner.forget();
        }
        let mut plan = Plan::default();
        let late = self.course.config.deadlines.planner;
        self.planner
            .plan_again(observation, (recorded, late), &mut plan);
        self.compare("planner", "plan", recorded, &plan);
        self.plans.insert(key(&plan.header), plan);
    }

    /// The share of the ticks by driver.
    pub fn share(&self) -> Share {
        let of = |driver: Driver| {
            let of = self
                .reasons
                .iter()
                .filter(|((of, _), _)| *of == driver.code());
            let count: u64 = of.map(|(_, count)| count).sum();
            count as f64 / self.ticks.max(1) as f64
        };
        Share {
            expert: of(Driver::Expert),
            policy: of(Driver::Policy),
            brake: of(Driver::Brake),
        }
    }

    /// Notes the first difference to the recording.
    fn compare<M: Message + Layout>(
        &mut self,
        process: &'static str,
        name: &str,
        recorded: &M,
        again: &M,
    ) {
        if self.difference.is_some() || recorded.as_bytes() == again.as_bytes() {
            return;
        }
        let Some(found) = first_difference(recorded, again) else {
            return;
        };
        let dot = if name.is_empty() { "" } else { "." };
        self.difference = Some(Difference {
            tick: recorded.header().tick,
            process,
            field: format!("{name}{dot}{}", found.field),
            recorded: found.left,
            recomputed: found.right,
            episode: recorded.header().episode,
            taken_ns: recorded.header().taken_ns,
        });
    }
}

/// Whether the command of a step went out.
fn is_sent(step: &Step) -> bool {
    step.lateness != Lateness::HeldBack.code()
}
