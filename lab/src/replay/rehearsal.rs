//! A run as the processes in real time make it, rehearsed in this process: the shipped world,
//! planner, controller, policy and judge with drawn instants. Missed ticks, late plans and
//! commands, silence, restarts of every process, a policy that is swapped, a person.

use controller::{Candidate, Controller, Inputs, Intent, PolicySlot, StartStage, Terms, TickEnd};
use gate::advice::Advisor;
use gate::judge::Rules;
use gate::query::Immediate;
use planner::Planner;
use policy::drawn::Spread;
use policy::{Provenance, Refusal};
use shm_config::config::{Clock as RunClock, Config, DECISION_HZ, GateMode, Late};
use shm_config::draw::Draw;
use shm_config::message::{
    Advice, Command, FEATURES, Header, Observation, Outcome, Plan, Step, Takeover,
};
use shm_config::{Instant, PlanTurns, RunGrid};
use sim::score::Score;
use sim::substeps::Substeps;
use sim::{World, WorldConfig};

use super::messages::AnyMessage;
use super::source::{InMemory, PolicyBytes};

const MS: u64 = 1_000_000;

const MODES: [GateMode; 4] = [
    GateMode::Expert,
    GateMode::Rules,
    GateMode::Policy,
    GateMode::Human,
];
const LATE: [Late; 3] = [Late::Count, Late::Brake, Late::Skip];

/// The file of a policy of random weights.
///
/// # Errors
/// When a weight is not finite.
pub fn policy_file(seed: u64) -> Result<PolicyBytes, Refusal> {
    let spread = Spread {
        weights: [0.05, 0.2],
        bias_min: -0.1,
        bias_max: 0.3,
    };
    let mlp = policy::drawn::net(seed, spread)?;
    let bytes = policy::encode(&mlp, &Provenance::default(), &[vec![0.5; FEATURES]]);
    let hash = policy::short_hash(&policy::sha256(&bytes));
    Ok(PolicyBytes { hash, bytes })
}

/// The numbers of a producer.
#[derive(Clone, Copy)]
struct Numbers {
    producer: u32,
    sequence: u64,
}

impl Numbers {
    fn of(producer: u32) -> Self {
        Self {
            producer,
            sequence: 0,
        }
    }

    fn next(&mut self, header: &mut Header) {
        self.sequence += 1;
        (header.sequence, header.producer) = (self.sequence, self.producer);
    }
}

/// How much goes wrong.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Trouble {
    /// Nothing: every tick is in time.
    None,
    /// Jitter, late and lost ticks, restarts, swaps, a person.
    All,
}

/// The run.
pub struct Rehearsal {
    config: Config,
    draw: Draw,
    trouble: Trouble,
    messages: Vec<AnyMessage>,
    policies: Vec<PolicyBytes>,
    world: World,
    score: Score,
    substeps: Substeps,
    episode: u32,
    tick: u64,
    first: u64,
    of_world: Numbers,
    of_progress: Numbers,
    of_episodes: Numbers,
    observation: Box<Observation>,
    planner: Planner,
    turns: PlanTurns,
    of_plans: Numbers,
    plan: Option<Plan>,
    controller: Controller,
    of_steps: Numbers,
    of_commands: Numbers,
    sent: Vec<(u64, Command)>,
    skipped: u64,
    dead: u64,
    advisor: Option<Advisor>,
    of_advice: Numbers,
    advice: Option<Advice>,
    of_takeovers: Numbers,
    taking_over: bool,
    version: u64,
    end: TickEnd,
}

impl Rehearsal {
    /// A run of this configuration; what goes wrong follows from the seed.
    ///
    /// # Errors
    /// When the configuration is out of range, or an episode has no map.
    pub fn new(config: Config, seed: u64, trouble: Trouble) -> anyhow::Result<Self> {
        let mut world = World::new(WorldConfig::from(&config))?;
        let first_seed = config.run.episode_seed(0);
        world.reset(first_seed)?;
        let hold = (config.world_rate_hz() / DECISION_HZ).round() as u64;
        let first = RunGrid::of(&config).first_instant(Instant(5_000 * MS)).0;
        Ok(Self {
            planner: planner(&config)?,
            draw: Draw::new(seed),
            trouble,
            messages: Vec::new(),
            policies: Vec::new(),
            world,
            score: Score::new(first_seed),
            substeps: Substeps::new(hold),
            episode: 0,
            tick: 0,
            first,
            of_world: Numbers::of(100),
            of_progress: Numbers::of(100),
            of_episodes: Numbers::of(100),
            observation: Box::default(),
            turns: PlanTurns::every(config.plan_ticks()),
            of_plans: Numbers::of(200),
            plan: None,
            controller: Controller::new(config.clone(), PolicySlot::new(None)),
            of_steps: Numbers::of(300),
            of_commands: Numbers::of(300),
            sent: Vec::new(),
            skipped: 0,
            dead: 0,
            advisor: advisor(&config),
            of_advice: Numbers::of(400),
            advice: None,
            of_takeovers: Numbers::of(500),
            taking_over: false,
            version: 0,
            end: TickEnd::default(),
            config,
        })
    }

    /// A run of a tenth of a second a tick with everything going wrong, in the mode and with
    /// the treatment of late ticks that the seed chooses.
    ///
    /// # Errors
    /// As [`Rehearsal::new`].
    pub fn troubled(seed: u64) -> anyhow::Result<Self> {
        let at = |count: usize, every: u64| (seed / every) as usize % count;
        let mut config = config(seed, MODES[at(MODES.len(), 1)]);
        config.deadlines.controller = LATE[at(LATE.len(), 1)];
        config.deadlines.planner = LATE[at(LATE.len(), 2)];
        Self::new(config, seed, Trouble::All)
    }

    /// Drives so many ticks; what was recorded.
    ///
    /// # Errors
    /// When an episode has no map.
    pub fn run(mut self, ticks: usize) -> anyhow::Result<InMemory> {
        for _ in 0..ticks {
            self.one()?;
        }
        let mut run = InMemory::new(self.config, self.messages);
        run.policies = self.policies;
        Ok(run)
    }

    fn goes_wrong(&mut self, one_in: u64) -> bool {
        self.trouble == Trouble::All && self.draw.one_in(one_in)
    }

    fn one(&mut self) -> anyhow::Result<()> {
        let period_ns = self.config.run.period_ns();
        if self.goes_wrong(400) {
            self.restart_world()?;
        }
        if self.goes_wrong(40) {
            self.tick += 1 + self.draw.below(3);
        }
        let late_ns = match self.goes_wrong(2) {
            true => self.draw.below(2 * MS),
            false => 50_000,
        };
        let scheduled_ns = self.first + self.tick * period_ns;
        let released_ns = scheduled_ns + late_ns;
        if self.tick > 0 {
            self.advance(released_ns)?;
        }
        self.publish(scheduled_ns, released_ns);
        self.plan()?;
        self.control(scheduled_ns, released_ns)?;
        self.tick += 1;
        Ok(())
    }

    fn restart_world(&mut self) -> anyhow::Result<()> {
        for numbers in [
            &mut self.of_world,
            &mut self.of_progress,
            &mut self.of_episodes,
        ] {
            *numbers = Numbers::of(numbers.producer + 1);
        }
        self.first += (self.tick + 3) * self.config.run.period_ns();
        self.tick = 0;
        let seed = self.config.run.episode_seed(self.episode);
        self.world.reset(seed)?;
        self.score = Score::new(seed);
        let hold = (self.config.world_rate_hz() / DECISION_HZ).round() as u64;
        self.substeps = Substeps::new(hold);
        Ok(())
    }

    /// The world's move: the newest command that is young enough, or the brake.
    fn advance(&mut self, now_ns: u64) -> anyhow::Result<()> {
        let due = self.substeps.take(self.tick);
        if due == 0 {
            return Ok(());
        }
        let limit_ns = self.config.limits.command_age_ns();
        let newest = self
            .sent
            .iter()
            .rev()
            .find(|(sent_ns, _)| *sent_ns <= now_ns);
        let young = newest.map(|(_, command)| command).filter(|command| {
            command.header.episode == self.episode
                && now_ns.saturating_sub(command.header.taken_ns) <= limit_ns
        });
        let action = self.score.obey(young, Instant(now_ns + 2_000));
        for _ in 0..due {
            let Some(step) = self.world.substep(action) else {
                continue;
            };
            self.score.count(&step);
            if step.has_ended() {
                return self.end_episode(step.outcome, now_ns);
            }
        }
        Ok(())
    }

    fn header(&self, now_ns: u64) -> Header {
        Header {
            tick: self.tick,
            taken_ns: now_ns,
            episode: self.episode,
            ..Header::default()
        }
    }

    fn end_episode(&mut self, outcome: Outcome, now_ns: u64) -> anyhow::Result<()> {
        let mut episode = self.score.episode(&self.world, outcome);
        episode.header = self.header(now_ns);
        self.of_episodes.next(&mut episode.header);
        self.messages.push(AnyMessage::Episode(episode));
        self.episode += 1;
        let seed = self.config.run.episode_seed(self.episode);
        self.world.reset(seed)?;
        self.score = Score::new(seed);
        Ok(())
    }

    fn publish(&mut self, scheduled_ns: u64, released_ns: u64) {
        let share = self.substeps.share(self.tick);
        self.world.observe_between(share, &mut self.observation);
        self.observation.header = self.header(released_ns);
        self.of_world.next(&mut self.observation.header);
        self.observation.scheduled_ns = scheduled_ns;
        self.observation.released_ns = released_ns;
        self.observation.published_ns = released_ns + 60_000;
        self.messages
            .push(AnyMessage::Observation(*self.observation));
        let mut progress = self.score.progress(&self.world, Outcome::Driving);
        progress.header = self.header(released_ns);
        self.of_progress.next(&mut progress.header);
        self.messages.push(AnyMessage::Progress(progress));
    }

    fn plan(&mut self) -> anyhow::Result<()> {
        if self.goes_wrong(300) {
            self.of_plans = Numbers::of(self.of_plans.producer + 1);
            self.planner = planner(&self.config)?;
        }
        if self.goes_wrong(30) || !self.turns.take(&self.observation.header) {
            return Ok(());
        }
        let mut plan = Plan::default();
        self.planner.plan(&self.observation, &mut plan);
        plan.planning_ns = 400_000 + self.draw.below(MS);
        let is_late = self.goes_wrong(50);
        if is_late && !plan.answer_late(self.config.deadlines.planner) {
            return Ok(());
        }
        self.of_plans.next(&mut plan.header);
        self.messages.push(AnyMessage::Plan(plan));
        self.plan = Some(plan);
        Ok(())
    }

    fn control(&mut self, scheduled_ns: u64, released_ns: u64) -> anyhow::Result<()> {
        if self.dead > 0 {
            self.dead -= 1;
            self.skipped += 1;
            if self.dead == 0 {
                self.restart_controller();
            }
            return Ok(());
        }
        if self.goes_wrong(250) {
            // Long enough that the world brakes.
            self.dead = 6 + self.draw.below(6);
            return Ok(());
        }
        if self.draw.one_in(200) && self.config.gate.mode != GateMode::Expert {
            self.swap()?;
        }
        let planned_ns = released_ns + 1_500_000 + self.draw.below(MS);
        let inputs = self.inputs(planned_ns);
        let now = Instant(planned_ns);
        self.controller.admit(&inputs, now);
        self.controller.decide(self.tick, now, Intent::Drive);
        let late_ns = match self.goes_wrong(60) {
            true => self.config.run.period_ns() + self.draw.below(20 * MS),
            false => 200_000,
        };
        let decided = now.after_ns(late_ns);
        let is_sent = self.controller.complete(Instant(scheduled_ns), decided);
        let commanded_ns = decided.0 + 30_000;
        if is_sent {
            let command = &mut self.controller.step_mut().command;
            self.of_commands.next(&mut command.header);
            self.sent.push((commanded_ns, *command));
            self.messages.push(AnyMessage::Command(*command));
        }
        self.controller.propose_in_shadow();
        let step = self.controller.step_mut();
        step.skipped = self.skipped;
        step.timings.released_ns = released_ns;
        step.timings.started_ns = planned_ns - MS;
        step.timings.planned_ns = planned_ns;
        step.timings.commanded_ns = commanded_ns;
        self.of_steps.next(&mut step.header);
        let step = *step;
        self.messages.push(AnyMessage::Step(step));
        self.controller.run_canary(&mut self.end);
        self.counsel(&step, commanded_ns);
        Ok(())
    }

    fn restart_controller(&mut self) {
        let policy = None;
        self.controller = Controller::new(self.config.clone(), PolicySlot::new(policy));
        self.of_steps = Numbers::of(self.of_steps.producer + 1);
        self.of_commands = Numbers::of(self.of_steps.producer);
        self.skipped = 0;
    }

    /// New weights, active at once.
    fn swap(&mut self) -> anyhow::Result<()> {
        self.version += 1;
        let file = policy_file(self.version)?;
        let terms = Terms {
            config: &self.config,
            version: self.version,
            clock: || Instant(0),
        };
        let policy = controller::build(&file.bytes, &terms)?;
        self.policies.push(file);
        let start = match self.draw.one_in(2) {
            true => StartStage::Settled,
            false => StartStage::Shadow,
        };
        let candidate = Candidate { policy, start };
        self.end = TickEnd::default();
        self.controller.adopt(candidate, self.tick, &mut self.end);
        Ok(())
    }

    fn inputs(&mut self, planned_ns: u64) -> Inputs {
        let mut inputs = Inputs::default();
        inputs.admitted.observation_ns = planned_ns - MS;
        inputs.admitted.plan_ns = planned_ns - 10_000;
        inputs.admitted.advice_ns = planned_ns - 9_000;
        inputs.admitted.takeover_ns = planned_ns - 1_000;
        if !self.goes_wrong(40) {
            inputs.observation.keep(&self.observation);
        }
        // A plan that comes too late is read a tick later.
        if !self.goes_wrong(12) {
            inputs.plan = self.plan.take().into();
        }
        inputs.advice = self.advice.take().into();
        if self.config.gate.mode == GateMode::Human {
            inputs.takeover = self.takeover(planned_ns).into();
        }
        inputs
    }

    fn takeover(&mut self, planned_ns: u64) -> Option<Takeover> {
        if self.draw.one_in(60) {
            self.taking_over = !self.taking_over;
        }
        let mut takeover = Takeover {
            steer: self.draw.within(-0.2, 0.2),
            pedal: self.draw.within(-0.2, 0.5),
            active: u32::from(self.taking_over),
            ..Takeover::default()
        };
        takeover.header.taken_ns = planned_ns - 5 * MS;
        takeover.header.tick = self.tick;
        self.of_takeovers.next(&mut takeover.header);
        self.messages.push(AnyMessage::Takeover(takeover));
        self.draw.one_in(2).then_some(takeover)
    }

    fn counsel(&mut self, step: &Step, commanded_ns: u64) {
        if self.goes_wrong(500) {
            self.advisor = advisor(&self.config);
            self.of_advice = Numbers::of(self.of_advice.producer + 1);
        }
        if self.goes_wrong(20) {
            return;
        }
        let Some(advisor) = &mut self.advisor else {
            return;
        };
        let now = Instant(commanded_ns + self.draw.below(5 * MS));
        let mut advice = advisor.consider(step, now);
        self.of_advice.next(&mut advice.header);
        self.messages.push(AnyMessage::Advice(advice));
        self.advice = Some(advice);
    }
}

/// A planner whose answers do not depend on this machine's speed.
fn planner(config: &Config) -> anyhow::Result<Planner> {
    let mut lockstep = config.clone();
    lockstep.run.clock = RunClock::Lockstep;
    Ok(Planner::new(&lockstep)?)
}

fn advisor(config: &Config) -> Option<Advisor> {
    let rules = Rules::new(config.vehicle, config.safety);
    let has_gate = config.gate.mode == GateMode::Rules;
    has_gate.then(|| Advisor::new(&config.gate, Box::new(Immediate::new(rules))))
}

/// A configuration for a kind of run; `seed` is of the world.
pub fn config(seed: u64, mode: GateMode) -> Config {
    let mut config = Config::default();
    config.run.seed = seed;
    config.gate.mode = mode;
    config.gate.period_s = 0.5;
    config.gate.dwell_s = 0.3;
    (config.policy.shadow_ticks, config.policy.watch_ticks) = (20, 40);
    // Random nets are no good drivers; they may drive all the same.
    (config.policy.veto_rate_max, config.policy.jump_max) = (0.9, 2.0);
    config
}
