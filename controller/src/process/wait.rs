//! What a tick of the controller waits for, never longer than its deadline.

use runtime::{DueTick, Release, TickLoop, TickSchedule};
use shm_config::config::Config;
use shm_config::message::{Advice, Message, Observation, Plan, Refusal};
use shm_config::services::PLAN;
use shm_config::time::Clock;
use shm_config::{Instant, PlanTurns, RunGrid};

use crate::Inputs;
use crate::ports::Ports;

/// Waits for the inputs of a tick.
pub struct Waiting {
    grid: RunGrid,
    /// The grid of the ticks.
    pub schedule: TickSchedule,
    turns: PlanTurns,
    pub lockstep: bool,
    asks_gate: bool,
    observation_wait_ns: u64,
    plan_wait_ns: u64,
    plan_age_ns: u64,
    lockstep_wait_ns: u64,
    /// A peer that exceeded a wait is not waited for until its next message.
    planner_silent: bool,
    gate_silent: bool,
    /// The newest tick whose step was published.
    pub stepped: Option<u64>,
    /// World and tick answered last. What a world publishes between two ticks
    /// carries the number of the first.
    pub answered: Option<(u32, u64)>,
}

impl Waiting {
    pub fn new(config: &Config) -> Self {
        let period_ns = config.run.period_ns();
        let share = |share: f64| (period_ns as f64 * share) as u64;
        Self {
            grid: RunGrid::of(config),
            schedule: TickSchedule::following(period_ns),
            turns: PlanTurns::every(config.plan_ticks()),
            lockstep: config.run.is_lockstep(),
            asks_gate: config.gate.has_process(),
            observation_wait_ns: share(config.limits.observation_wait),
            plan_wait_ns: share(config.limits.plan_wait),
            plan_age_ns: config.age_limit_ns(PLAN.row.age_limit),
            lockstep_wait_ns: config.peer_wait_ns(),
            planner_silent: false,
            gate_silent: false,
            stepped: None,
            answered: None,
        }
    }

    /// Sleeps until a new observation or the grid asks for a tick; `None` when the
    /// time given has passed without either.
    pub fn tick(
        &mut self,
        run: &TickLoop,
        ports: &mut Ports,
        inputs: &mut Inputs,
    ) -> Option<DueTick> {
        let grid = self.grid;
        // An observation that is refused gets no tick. The clock is read after the
        // message came, which else would be from the future.
        let mut admitted = Instant::default();
        let door = |observation: &Observation| {
            let at = run.now();
            grid.admit(observation, at).inspect(|()| admitted = at)
        };
        let has_come = ports
            .observations
            .newest_into(&mut inputs.observation, door);
        let now = run.now();
        if let Some(observation) = inputs.observation.get().filter(|_| has_come) {
            let is_new = self.answered != Some(origin(observation));
            let due = self.due(observation, is_new, now);
            inputs.admitted.observation_ns = admitted.0;
            // In lockstep nothing is read between two ticks, so that runs repeat.
            if !is_new && self.lockstep {
                inputs.observation.clear();
            }
            if due.is_some() {
                return due;
            }
        }
        let deadline = match self.lockstep {
            true => None,
            false => self.schedule.deadline(self.observation_wait_ns),
        };
        if deadline.is_some_and(|deadline| now >= deadline) {
            return self.schedule.on_timeout(now, self.observation_wait_ns);
        }
        run.wait(deadline, now);
        None
    }

    fn due(&mut self, observation: &Observation, is_new: bool, now: Instant) -> Option<DueTick> {
        let scheduled = Instant(observation.scheduled_ns);
        match self.lockstep {
            false => self.schedule.on_observation(scheduled, now),
            true => is_new.then_some(DueTick {
                scheduled,
                due: scheduled,
                release: Release::Observation,
                skipped: 0,
            }),
        }
    }

    /// The run's clock within the tick of these inputs.
    pub fn clock(&self, run: &TickLoop, inputs: &Inputs) -> RunClock {
        match (self.lockstep, inputs.observation.get()) {
            (true, Some(observation)) => RunClock::Stands(observation.header.taken()),
            _ => RunClock::Machine(run.member.clock),
        }
    }

    /// The tick that is due now begins; it needs the plan of its observation where the
    /// planner makes one, and in lockstep the gate's answer to the step before.
    pub fn begin(&mut self, inputs: &Inputs, due: DueTick, now: Instant) -> Begun {
        let header = inputs.observation.get().map(|o| o.header);
        let until = match self.lockstep {
            true => now.after_ns(self.lockstep_wait_ns),
            false => due.scheduled.after_ns(self.plan_wait_ns),
        };
        Begun {
            due,
            started: now,
            until,
            needs_plan: header.is_some_and(|header| self.turns.take(&header)),
        }
    }

    /// Reads plan and advice; returns whether the tick has what it needs, or is not to
    /// wait for it any longer.
    pub fn has_peers(
        &mut self,
        run: &TickLoop,
        ports: &mut Ports,
        inputs: &mut Inputs,
        begun: &Begun,
    ) -> bool {
        let header = inputs.observation.get().map(|o| o.header);
        let tick = header.map(|header| header.tick);
        let episode = header.map(|header| header.episode);
        let clock = self.clock(run, inputs);
        let plan_age_ns = self.plan_age_ns;
        let at = &mut inputs.admitted;
        let plan_door = |plan: &Plan| {
            let now = clock.now();
            admit_plan(plan, now, plan_age_ns, episode).inspect(|()| at.plan_ns = now.0)
        };
        if ports.plans.newest_into(&mut inputs.plan, plan_door) {
            self.planner_silent = false;
        }
        // Advice has its own expiry; its age is not limited.
        let advice_door = |advice: &Advice| {
            let now = clock.now();
            advice
                .admit(now, u64::MAX)
                .inspect(|()| at.advice_ns = now.0)
        };
        if ports.advices.newest_into(&mut inputs.advice, advice_door) {
            self.gate_silent = false;
        }
        let plan_tick = inputs.plan.get().map(|plan| plan.header.tick);
        let advice_tick = inputs.advice.get().map(|advice| advice.header.tick);
        let planned = self.planner_silent || !begun.needs_plan || plan_tick == tick;
        let advised = !self.lockstep
            || !self.asks_gate
            || self.gate_silent
            || self.stepped.is_none()
            || advice_tick >= self.stepped;
        let is_over = run.now() >= begun.until;
        if is_over {
            self.planner_silent |= self.lockstep && !planned;
            self.gate_silent |= !advised;
        }
        is_over || (planned && advised)
    }

    /// In real time, within the tick: waits for the plan, until the tick cannot wait any
    /// longer. In lockstep the peers are waited for before the tick.
    pub fn peers(&mut self, run: &TickLoop, ports: &mut Ports, inputs: &mut Inputs, begun: &Begun) {
        while !self.lockstep && !self.has_peers(run, ports, inputs, begun) {
            run.wait(Some(begun.until), run.now());
        }
    }
}

/// A tick that has begun.
#[derive(Clone, Copy)]
pub struct Begun {
    pub due: DueTick,
    /// When it began to wait for its peers.
    pub started: Instant,
    /// When that wait is over.
    pub until: Instant,
    /// The planner makes a plan of its observation.
    needs_plan: bool,
}

/// The run's clock within one tick.
#[derive(Clone, Copy)]
pub enum RunClock {
    /// The machine's.
    Machine(Clock),
    /// In lockstep, that of the tick's observation.
    Stands(Instant),
}

impl RunClock {
    pub fn now(self) -> Instant {
        match self {
            Self::Machine(clock) => clock(),
            Self::Stands(now) => now,
        }
    }
}

/// Admits a plan: as the message's own check, and of the current episode, if there is one.
fn admit_plan(
    plan: &Plan,
    now: Instant,
    limit_ns: u64,
    episode: Option<u32>,
) -> Result<(), Refusal> {
    plan.admit(now, limit_ns)?;
    match episode {
        Some(expected) if expected != plan.header.episode => Err(Refusal::Episode {
            episode: plan.header.episode,
            expected,
        }),
        _ => Ok(()),
    }
}

/// World and tick of an observation.
pub fn origin(observation: &Observation) -> (u32, u64) {
    (observation.header.producer, observation.header.tick)
}
