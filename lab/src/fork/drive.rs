//! A fork with a change: from the recorded state on, in lockstep order, with another policy,
//! planner, judge or setting.

use std::collections::BTreeMap;
use std::ops::ControlFlow;

use controller::{Controller, Inputs, Intent, Policy, PolicySlot};
use gate::advice::Advisor;
use gate::judge::{FaultyJudge, Rules};
use gate::query::{Immediate, QueryQueue};
use planner::Planner;
use shm_config::config::{Clock as RunClock, Config, GateMode};
use shm_config::message::{
    Before, Command, Driver, Episode, Header, Message, Observation, Outcome, Plan, Step,
};
use shm_config::{Instant, PlanTurns};
use stack::Clock;
use stack::driver::{DriverKind, EpisodeDriver};

use crate::replay::rebuild::{Applied, Mover, Rebuilt, observe};

/// The state of a recorded run at an observation that has no tick yet.
#[derive(Clone)]
pub struct Start {
    /// The world.
    pub rebuilt: Rebuilt,
    /// Its observation.
    pub observation: Box<Observation>,
    /// The controller's last step, and the state after it; none at the run's beginning.
    pub last: Option<(Box<Step>, Before)>,
    /// Observations and plans of the planner's memory, the oldest first.
    pub planned: Vec<(Observation, Plan)>,
}

/// What drives on.
pub enum Wheel {
    /// Planner, controller and judge of the configuration, with this policy or none.
    Stack(Option<Box<dyn Policy>>),
    /// A driver of its own.
    Driver(DriverKind),
}

/// What a fork is driven with.
pub struct Drive<'a> {
    /// The configuration.
    pub config: &'a Config,
    /// Instants of the world.
    pub mover: &'a Mover,
    /// For how long at most, s.
    pub seconds: f64,
    /// Measures how long plans take.
    pub clock: Clock,
}

/// How it went.
#[derive(Clone, Debug)]
pub struct Driven {
    /// The episode as it stands at the end.
    pub episode: Episode,
    /// Ticks that were driven.
    pub ticks: u64,
    /// Ticks by driver and reason.
    pub reasons: BTreeMap<(u32, u32), u64>,
    /// Ticks with contact since the fork.
    pub contacts: u64,
}

/// Planner, controller and gate between their messages.
struct Loop {
    planner: Planner,
    turns: PlanTurns,
    plan: Plan,
    controller: Controller,
    advisor: Option<Advisor>,
    inputs: Inputs,
}

impl Drive<'_> {
    /// Drives on until the episode ends or the time is up.
    ///
    /// # Errors
    /// When the configuration, or the driver's file, is refused.
    pub fn run(&self, start: Start, wheel: Wheel) -> anyhow::Result<Driven> {
        self.run_watched(start, wheel, |_| ControlFlow::Continue(()))
    }

    /// The same. `watch` gets each step of the stack, and none of a driver of its own; it may
    /// end the drive.
    ///
    /// # Errors
    /// As [`Drive::run`].
    pub fn run_watched(
        &self,
        start: Start,
        wheel: Wheel,
        mut watch: impl FnMut(&Step) -> ControlFlow<()>,
    ) -> anyhow::Result<Driven> {
        let Start {
            mut rebuilt,
            mut observation,
            last,
            planned,
        } = start;
        let touched = contacts(&rebuilt);
        let begun = observation.header;
        let mut driver = match wheel {
            Wheel::Stack(policy) => {
                Hands::Loop(Box::new(Loop::new(self.config, policy, last, &planned)?))
            }
            Wheel::Driver(kind) => {
                let mut driver = EpisodeDriver::new(kind, self.config, self.clock)?;
                driver.begin(rebuilt.world.seed());
                Hands::Driver(Box::new(driver))
            }
        };
        let period_ns = self.config.run.period_ns();
        let ticks_max = (self.seconds * 1e9 / period_ns as f64).round() as u64;
        let mut reasons = BTreeMap::new();
        let mut outcome = Outcome::Driving;
        let mut ticks = 0;
        while outcome == Outcome::Driving && ticks < ticks_max {
            let (command, is_watched) = driver.command(&observation, &mut rebuilt, &mut watch);
            *reasons.entry((command.driver, command.reason)).or_default() += 1;
            ticks += 1;
            for _ in 0..self.mover.instants() {
                let next = rebuilt.index + 1;
                let end = self
                    .mover
                    .advance(&mut rebuilt, next, &Applied::Command(command));
                if let Some(end) = end {
                    outcome = end.outcome;
                    break;
                }
            }
            let header = &mut observation.header;
            header.tick = begun.tick.saturating_add(ticks);
            header.taken_ns = begun.taken_ns.saturating_add(ticks * period_ns);
            header.sequence = header.sequence.wrapping_add(1);
            observation.scheduled_ns = observation.scheduled_ns.saturating_add(period_ns);
            observation = observe(&rebuilt, &observation);
            if is_watched.is_break() {
                break;
            }
        }
        let outcome = match outcome {
            Outcome::Driving => Outcome::Stopped,
            ended => ended,
        };
        Ok(Driven {
            contacts: contacts(&rebuilt) - touched,
            episode: Episode {
                header: observation.header,
                ..rebuilt.score.episode(&rebuilt.world, outcome)
            },
            ticks,
            reasons,
        })
    }
}

/// What gives the commands.
enum Hands {
    Loop(Box<Loop>),
    Driver(Box<EpisodeDriver>),
}

impl Hands {
    fn command(
        &mut self,
        observation: &Observation,
        rebuilt: &mut Rebuilt,
        watch: &mut impl FnMut(&Step) -> ControlFlow<()>,
    ) -> (Command, ControlFlow<()>) {
        match self {
            Hands::Loop(own) => own.tick(observation, watch),
            Hands::Driver(driver) => {
                let command = driver.command(observation, &mut rebuilt.world);
                (command, ControlFlow::Continue(()))
            }
        }
    }
}

impl Loop {
    fn new(
        config: &Config,
        policy: Option<Box<dyn Policy>>,
        last: Option<(Box<Step>, Before)>,
        planned: &[(Observation, Plan)],
    ) -> anyhow::Result<Loop> {
        let mut config = config.clone();
        // The result must not depend on this machine's speed.
        config.run.clock = RunClock::Lockstep;
        let mut planner = Planner::new(&config)?;
        let mut plan = Plan::default();
        if planner.remembers() {
            for (observation, _) in planned {
                planner.plan(observation, &mut plan);
            }
        }
        let mut controller = Controller::new(config.clone(), PolicySlot::new(policy));
        for (observation, _) in planned {
            controller.follow(observation);
        }
        if let Some((step, before)) = last {
            plan = step.plan;
            controller.resume(&before, *step);
        }
        Ok(Loop {
            turns: PlanTurns::every(config.plan_ticks()),
            advisor: advisor(&config),
            planner,
            plan,
            controller,
            inputs: Inputs::default(),
        })
    }

    fn tick(
        &mut self,
        observation: &Observation,
        watch: &mut impl FnMut(&Step) -> ControlFlow<()>,
    ) -> (Command, ControlFlow<()>) {
        let Header { tick, .. } = observation.header;
        let now = observation.header.taken();
        self.inputs.observation.keep(observation);
        self.inputs.plan.clear();
        if self.turns.take(observation.header()) {
            self.planner.plan(observation, &mut self.plan);
            self.inputs.plan.keep(&self.plan);
        }
        let step = self.controller.tick(&self.inputs, tick, now, Intent::Drive);
        let command = step.command;
        let is_watched = watch(step);
        if let Some(advisor) = &mut self.advisor {
            let advice = advisor.consider(step, Instant(step.header.taken_ns));
            self.inputs.advice.keep(&advice);
        }
        (command, is_watched)
    }
}

/// The judge of the configuration; exact geometry in place of a model.
pub fn advisor(config: &Config) -> Option<Advisor> {
    let has_gate = match config.gate.mode {
        GateMode::Expert | GateMode::Policy | GateMode::Human | GateMode::Takeover => false,
        GateMode::Rules
        | GateMode::Vlm
        | GateMode::Paper
        | GateMode::Distilled
        | GateMode::Replay => true,
    };
    let rules = || Box::new(Immediate::new(Rules::new(config.vehicle, config.safety)));
    has_gate.then(|| {
        let queue: Box<dyn QueryQueue> = match config.faulty_judge.is_active() {
            true => Box::new(FaultyJudge::new(&config.faulty_judge, rules())),
            false => rules(),
        };
        Advisor::new(&config.gate, queue)
    })
}

/// Ticks of the episode in contact with a vehicle or an object.
pub fn contacts(rebuilt: &Rebuilt) -> u64 {
    let progress = rebuilt.score.progress(&rebuilt.world, Outcome::Driving);
    progress.contacts()
}

/// The share of the ticks in which a driver drove.
pub fn share(driven: &Driven, driver: Driver) -> f64 {
    let of = driven
        .reasons
        .iter()
        .filter(|((of, _), _)| *of == driver.code());
    let count: u64 = of.map(|(_, count)| count).sum();
    count as f64 / driven.ticks.max(1) as f64
}
