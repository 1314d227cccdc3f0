//! The processes behind their checks: an admitted message must not stop a tick.

use std::cell::RefCell;

use controller::{Controller, Inputs, Intent, Policy, PolicySlot};
use gate::advice::Advisor;
use gate::judge::Rules;
use gate::query::Immediate;
use learner::assembler::{Assembler, Counts, Labelling};
use planner::Planner;
use shm_config::config::planner::Method;
use shm_config::config::{Clock, Config, GateMode};
use shm_config::message::{Command, Newest, Observation, Plan, Step};
use shm_config::{Instant, Message};
use sim::{World, WorldConfig};
use vehicle::Action;

use crate::{Said, read};

/// Time from tick to tick, ns.
const PERIOD_NS: u64 = 100_000_000;
/// Most messages of one input, so that a run of the target stays short.
const MESSAGES_MAX: usize = 24;

const METHODS: [Method; 4] = [
    Method::RrtStar,
    Method::Informed,
    Method::Kinodynamic,
    Method::Mpc,
];

thread_local! {
    /// Built once, because they allocate much; they are reset between two inputs.
    static PLANNERS: RefCell<Vec<Planner>> = RefCell::new(planners());
    static WORLD: RefCell<World> = RefCell::new(
        World::new(WorldConfig::from(&Config::default())).expect("the defaults"),
    );
}

fn planners() -> Vec<Planner> {
    let of = |method| {
        let mut config = Config::default();
        config.planner.method = method;
        // Without a time limit of the solver, because an input must repeat exactly.
        config.run.clock = Clock::Lockstep;
        Planner::new(&config).expect("the defaults")
    };
    METHODS.map(of).into()
}

/// The first byte chooses the method; observations follow. A plan of each admitted
/// observation must itself pass the check.
pub fn planner(bytes: &[u8]) -> Said {
    let Some((method, rest)) = bytes.split_first() else {
        return Said::Refused;
    };
    PLANNERS.with_borrow_mut(|planners| {
        let planner = &mut planners[usize::from(*method) % METHODS.len()];
        planner.forget();
        let mut plan = Box::<Plan>::default();
        let mut is_admitted = false;
        for chunk in rest.chunks(size_of::<Observation>()).take(3) {
            let observation = read::<Observation>(chunk);
            if observation.check().is_err() {
                continue;
            }
            is_admitted = true;
            planner.plan(&observation, &mut plan);
            assert_eq!(plan.check(), Ok(()), "a plan that others refuse");
        }
        Said::of(is_admitted)
    })
}

/// Proposes the action in the features, valid or not.
struct Echo;

impl Policy for Echo {
    fn infer(&mut self, features: &[f32]) -> Option<Action> {
        Some(Action {
            steer: f64::from(features[0]) * 2.0 - 1.0,
            pedal: f64::from(features[features.len() - 1]) / f64::from(features[1]),
        })
    }
    fn version(&self) -> u64 {
        1
    }
    fn hash(&self) -> u64 {
        1
    }
}

const MODES: [GateMode; 5] = [
    GateMode::Rules,
    GateMode::Human,
    GateMode::Expert,
    GateMode::Policy,
    GateMode::Takeover,
];

/// The first byte chooses the gate's mode. Messages follow, each with a byte for its
/// type and its memory; two bits of that byte end the tick, or set the message's time
/// to that of the tick. The command and step of each tick must pass their checks.
pub fn controller(bytes: &[u8]) -> Said {
    let Some((mode, mut rest)) = bytes.split_first() else {
        return Said::Refused;
    };
    let mut config = Config::default();
    config.gate.mode = MODES[usize::from(*mode) % MODES.len()];
    let policy: Box<dyn Policy> = Box::new(Echo);
    let mut controller = Controller::new(config, PolicySlot::new(Some(policy)));
    let mut inputs = Inputs::default();
    let (mut tick, mut is_admitted) = (100, false);
    for _ in 0..MESSAGES_MAX {
        let Some((kind, after)) = rest.split_first() else {
            break;
        };
        let now = Instant(tick * PERIOD_NS);
        let on_time = (kind & 0x80 == 0).then_some(now);
        rest = match kind % 4 {
            0 => take(after, on_time, &mut inputs.observation),
            1 => take(after, on_time, &mut inputs.plan),
            2 => take(after, on_time, &mut inputs.advice),
            _ => take(after, on_time, &mut inputs.takeover),
        };
        if kind & 0x40 != 0 {
            is_admitted |= drive(&mut controller, &inputs, tick);
            inputs.clear();
            tick += 1;
        }
    }
    is_admitted |= drive(&mut controller, &inputs, tick);
    Said::of(is_admitted)
}

/// Runs one tick; returns whether it had an observation.
fn drive(controller: &mut Controller, inputs: &Inputs, tick: u64) -> bool {
    let step = controller.tick(inputs, tick, Instant(tick * PERIOD_NS), Intent::Drive);
    assert_eq!(step.command.check(), Ok(()), "a command that others refuse");
    assert_eq!(step.check(), Ok(()), "a step that others refuse");
    step.observation_age_ns < PERIOD_NS
}

/// Reads one message from the bytes; returns the rest.
fn take<'a, M: Message>(bytes: &'a [u8], on_time: Option<Instant>, to: &mut Newest<M>) -> &'a [u8] {
    let (own, rest) = bytes.split_at(bytes.len().min(size_of::<M>()));
    let mut message = *read::<M>(own);
    if let Some(now) = on_time {
        message.header_mut().taken_ns = now.0;
    }
    to.keep(&message);
    rest
}

/// Steps, in order, as the gate and the learner read them.
pub fn steps(bytes: &[u8]) -> Said {
    let config = Config::default();
    let judge = Immediate::new(Rules::new(config.vehicle, config.safety));
    let mut advisor = Advisor::new(&config.gate, Box::new(judge));
    let labelling = Labelling {
        mode: config.gate.mode,
        wait_ns: PERIOD_NS,
        truncated_at: (bytes.len() % 2 == 1).then(|| config.horizon_ticks()),
    };
    let mut assembler = Assembler::new(labelling, Counts::default());
    let (mut is_admitted, mut transitions) = (false, 0);
    for chunk in bytes.chunks(size_of::<Step>()).take(4) {
        let step = read::<Step>(chunk);
        if step.check().is_err() {
            continue;
        }
        is_admitted = true;
        let advice = advisor.consider(&step, step.header.taken());
        assert_eq!(advice.check(), Ok(()), "advice that others refuse");
        assembler.push(&step, |_| transitions += 1);
    }
    assembler.finish(|_| transitions += 1);
    assert_eq!(assembler.counts().transitions(), transitions);
    Said::of(is_admitted)
}

/// The first byte is the world's seed; commands follow, each applied for a tick. The
/// world's observations must pass their check after any command.
pub fn world(bytes: &[u8]) -> Said {
    let Some((seed, rest)) = bytes.split_first() else {
        return Said::Refused;
    };
    WORLD.with_borrow_mut(|world| {
        world.reset(u64::from(seed % 8)).expect("a map");
        let mut observation = Observation::default();
        let mut is_admitted = false;
        for chunk in rest.chunks(size_of::<Command>()).take(MESSAGES_MAX) {
            let command = read::<Command>(chunk);
            let action = match command.check() {
                Ok(()) => command.action(),
                Err(_) => Action::BRAKE,
            };
            is_admitted |= command.check().is_ok();
            world.step(action);
            world.observe(&mut observation);
            assert_eq!(
                observation.check(),
                Ok(()),
                "an observation that others refuse"
            );
            if world.last_step().has_ended() {
                break;
            }
        }
        Said::of(is_admitted)
    })
}
