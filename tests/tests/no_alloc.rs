//! No tick of planner or controller allocates: the test runs the shipped loops, with
//! waiting, accounting and swaps of weights, on real ports of a private run. A world in
//! this test drives the car.
//!
//! Between ticks (connecting to peers, heartbeats) the loops may allocate. Each loop is
//! the shipped one, and each process is wrapped so that only its waits and ticks are
//! counted.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

use allocation_counter::measure;
use controller::ControllerProcess;
use planner::PlannerProcess;
use policy::{Activation, Compression, Layer, Mlp, Provenance, Windows};
use runtime::{FixedRate, Flow, Member, SetUpError, TickLoop};
use shm_config::config::{Clock, Config, GateMode};
use shm_config::message::{
    Advice, Command, Driver, FEATURES, INPUTS_WITH_MOTION, Observation, PlanOutcome, PolicyState,
    PolicyStatus, Preference, Roster, Step, Takeover, Verdict, Weights,
};
use shm_config::run::{RunName, RunPaths};
use shm_config::services::{
    ADVICE, COMMAND, OBSERVATION, POLICY_STATUS, Process, STEP, TAKEOVER, WEIGHTS,
};
use shm_config::time::monotonic;
use shm_config::wire::{Doorbell, Publisher, Subscriber, Wire};
use shm_config::{Instant, Message};
use sim::{World, WorldConfig};

const TICKS: u64 = 10_000;
/// Ticks in which ports may still connect to each other.
const WARM_UP: u64 = 20;
/// New weights are offered once in this many ticks.
const SWAP_TICKS: u64 = 500;
const PERIOD_NS: u64 = 100_000_000;

/// Follows its lane by the features alone, heading and offset, at 5 m/s: a net of the
/// experiment's size whose first three hidden numbers are those features. The last bias
/// makes each version a different file.
fn lane_keeper(version: u64) -> Vec<u8> {
    let layer = |inputs: usize, outputs: usize, activation| Layer {
        weights: vec![0.0; inputs * outputs],
        bias: vec![0.0; outputs],
        inputs,
        outputs,
        activation,
    };
    // Every other version is told how bodies move, and has a convolution.
    let takes_motion = version % 2 == 1;
    let inputs = [FEATURES, INPUTS_WITH_MOTION][usize::from(takes_motion)];
    let convolution = Windows {
        inputs,
        kept: inputs,
        window: 8,
        indices: (19..259).collect(),
        weights: vec![0.1; 8 * 32],
        bias: vec![0.0; 32],
    };
    let convolutions = Vec::from_iter(takes_motion.then_some(convolution));
    let seen = convolutions.last().map_or(inputs, Windows::outputs);
    let mut see = layer(seen, 256, Activation::Relu);
    for (hidden, feature) in [2, 8, 3].into_iter().enumerate() {
        see.weights[hidden * seen + feature] = 1.0;
    }
    let mut keep = layer(256, 256, Activation::Relu);
    for hidden in 0..3 {
        keep.weights[hidden * 256 + hidden] = 1.0;
    }
    let mut act = layer(256, 2, Activation::None);
    act.weights[..2].copy_from_slice(&[1.6, 0.675]);
    act.weights[256 + 2] = -6.75;
    act.bias = vec![-1.1375 + version as f32 * 1e-6, 0.3 * (5.0 + 1.0 / 3.6)];
    // Of the beams, as the learner's policies have it.
    let compression = Compression {
        from: FEATURES - 240,
        to: FEATURES,
        slope: 20.0,
    };
    let layers = vec![see, keep, act];
    let mlp = Mlp::convolved(compression, convolutions, layers).expect("layers that fit");
    policy::encode(&mlp, &Provenance::default(), &[vec![0.5; FEATURES]])
}

/// The allocations counted in one loop's waits and ticks.
#[derive(Default)]
struct Counts {
    allocations: AtomicU64,
    ticks: AtomicU64,
}

/// A shipped process whose waits and ticks are counted, but not its connections.
struct Counted<'a, P> {
    process: P,
    counts: &'a Counts,
}

impl<P> Counted<'_, P> {
    fn count<R>(&mut self, work: impl FnOnce(&mut P) -> R) -> R {
        let mut result = None;
        let taken = measure(|| result = Some(work(&mut self.process)));
        if self.counts.ticks.load(Ordering::Relaxed) > WARM_UP {
            let count = &self.counts.allocations;
            count.fetch_add(taken.count_total, Ordering::Relaxed);
        }
        result.expect("the work was done")
    }
}

impl<P: FixedRate> FixedRate for Counted<'_, P> {
    type Due = P::Due;

    fn ready(&mut self, run: &mut TickLoop) {
        self.process.ready(run);
    }
    fn update_connections(&mut self) {
        self.process.update_connections();
    }
    fn await_tick(&mut self, run: &mut TickLoop) -> Option<P::Due> {
        self.count(|process| process.await_tick(run))
    }
    fn tick(&mut self, run: &mut TickLoop, due: P::Due) -> Result<Flow, SetUpError> {
        self.counts.ticks.fetch_add(1, Ordering::Relaxed);
        self.count(|process| process.tick(run, due))
    }
    fn stop(&mut self, run: &mut TickLoop, now: Instant) -> Flow {
        self.process.stop(run, now)
    }
    fn finish(&mut self, run: &mut TickLoop) {
        self.process.finish(run);
    }
}

/// All other processes of the run: world, gate, driver, learner.
struct Rest {
    bell: Doorbell,
    observations: Publisher<Observation>,
    advices: Publisher<Advice>,
    takeovers: Publisher<Takeover>,
    weights: Publisher<Weights>,
    commands: Subscriber<Command>,
    steps: Subscriber<Step>,
    statuses: Subscriber<PolicyStatus>,
}

impl Rest {
    fn open(wire: &Wire) -> Self {
        let failed = "shared memory";
        Self {
            bell: wire.doorbell(Process::World).expect(failed),
            observations: wire.publisher(OBSERVATION).expect(failed),
            advices: wire.publisher(ADVICE).expect(failed),
            takeovers: wire.publisher(TAKEOVER).expect(failed),
            weights: wire.publisher(WEIGHTS).expect(failed),
            commands: wire.subscriber(COMMAND).expect(failed),
            steps: wire.subscriber(STEP).expect(failed),
            statuses: wire.subscriber(POLICY_STATUS).expect(failed),
        }
    }

    fn update_connections(&mut self) {
        self.observations.update_connections();
        self.advices.update_connections();
        self.takeovers.update_connections();
        self.weights.update_connections();
        self.commands.update_connections();
        self.steps.update_connections();
        self.statuses.update_connections();
    }

    /// Offers new weights and waits until the controller runs them in shadow mode.
    #[allow(clippy::disallowed_methods)] // a test without processes reads the clock
    fn swap(&mut self, version: u64) {
        let file = lane_keeper(version);
        let sha256 = policy::sha256(&file);
        assert!(self.weights.offer(version, sha256, &file));
        let until = monotonic().after_ns(30_000_000_000);
        while monotonic() < until {
            if let Some(status) = self.statuses.newest(Message::check) {
                let is_its = status.offered_version == version;
                if is_its && status.state() == PolicyState::Shadow {
                    return;
                }
                assert_ne!(status.state(), PolicyState::Refused, "{}", status.refusal());
            }
            self.update_connections();
            self.bell.wait(Duration::from_millis(1));
        }
        panic!("version {version} was not adopted");
    }

    /// The command of this tick and its step.
    #[allow(clippy::disallowed_methods)] // a test without processes reads the clock
    fn answer(&mut self, tick: u64) -> (Command, Step) {
        let until = monotonic().after_ns(30_000_000_000);
        let (mut command, mut step) = (None, None);
        while monotonic() < until {
            let newest = self.commands.newest(Message::check);
            command = newest
                .filter(|newest| newest.header.tick == tick)
                .or(command);
            // Both may come between the look at the commands and this one at the steps.
            while let Some(received) = self.steps.receive() {
                step = Some(received).filter(|received| received.header.tick == tick);
            }
            match (command.take(), step.take()) {
                (Some(command), Some(step)) => return (command, step),
                one => (command, step) = one,
            }
            self.update_connections();
            self.bell.wait(Duration::from_millis(1));
        }
        panic!("no command for tick {tick}");
    }
}

/// What the ticks did; it shows that the count of zero is meaningful.
#[derive(Debug, Default)]
struct Done {
    planned: u64,
    judged: u64,
    expert: u64,
    policy: u64,
    versions: u64,
    version: u64,
    ready: bool,
    metres: f64,
}

impl Done {
    fn count(&mut self, step: &Step) {
        self.planned += u64::from(step.plan.outcome() != PlanOutcome::Blocked);
        let judged = [step.expert_assessment, step.policy_assessment]
            .map(|assessment| assessment.verdict() != Verdict::Absent);
        self.judged += u64::from(judged == [true, true]);
        self.versions += u64::from(step.weights_version != self.version);
        self.version = step.weights_version;
        self.expert += u64::from(step.driver() == Driver::Expert);
        self.policy += u64::from(step.driver() == Driver::Policy);
    }
}

#[allow(clippy::disallowed_methods)] // a test without processes chooses the clock
fn member(
    process: Process,
    (name, folder): (&RunName, &Path),
    roster: &Roster,
    stop: &Arc<AtomicBool>,
) -> Member {
    let wire = Wire::join(name, process).expect("shared memory");
    // As in a run: the ports check which process sent each message.
    wire.trust(roster);
    let mut config = Config::default();
    config.run.name = name.to_string();
    config.run.folder = folder.display().to_string();
    config.run.clock = Clock::Lockstep;
    config.gate.mode = GateMode::Rules;
    Member::embedded(process, config, wire, monotonic, stop.clone())
}

/// Drives this many ticks, swaps weights during them, and returns what was done.
fn drive(rest: &mut Rest) -> Done {
    let mut world = World::new(WorldConfig::default()).expect("a world");
    let mut observation = Box::<Observation>::default();
    let (mut done, mut seed) = (Done::default(), 100);
    world.reset(seed).expect("a map");
    for tick in 0..TICKS + WARM_UP {
        // A car that the safety check holds before an obstacle proves nothing more.
        if world.last_step().has_ended() || world.ticks() >= 400 {
            done.metres += world.driven_m();
            seed += 1;
            world.reset(seed).expect("a map");
        }
        if tick % SWAP_TICKS == SWAP_TICKS / 2 {
            rest.swap(1 + tick / SWAP_TICKS);
        }
        let header = &mut observation.header;
        (header.tick, header.episode) = (tick, seed as u32);
        header.taken_ns = (tick + 1) * PERIOD_NS;
        rest.takeovers.send(&mut Takeover {
            header: *header,
            ..Takeover::default()
        });
        let header = *header;
        world.observe(&mut observation);
        observation.header = header;
        rest.observations.send(&mut observation);
        let (command, step) = rest.answer(tick);
        done.count(&step);
        let preference = [Preference::Policy, Preference::Expert][(tick / 50 % 2) as usize];
        rest.advices.send(&mut Advice {
            header,
            preference: preference.code(),
            answers: 1,
            holds_until_ns: u64::MAX,
            ..Advice::default()
        });
        if let Some(status) = rest.statuses.newest(Message::check) {
            done.ready = status.state() == PolicyState::Ready;
        }
        rest.update_connections();
        world.step(command.action());
    }
    done
}

#[test]
fn ten_thousand_ticks_of_the_shipped_loops_allocate_nothing() {
    let control = measure(|| drop(std::hint::black_box(Vec::<u8>::with_capacity(100))));
    assert_eq!(control.count_total, 1, "the counter counts");
    let pid = std::process::id();
    let name: RunName = format!("t{pid}-alloc").parse().expect("a name");
    let folder = tempfile::tempdir().expect("a folder");
    let mut roster = Roster::default();
    for process in Process::ALL {
        roster.set(*process, Some(pid));
    }
    let wire = Wire::join(&name, Process::World).expect("shared memory");
    wire.trust(&roster);
    let mut rest = Rest::open(&wire);
    let stop = Arc::new(AtomicBool::new(false));
    let [planner, controller] = [Counts::default(), Counts::default()];
    let done = thread::scope(|scope| {
        let planning = scope.spawn(|| {
            let member = member(Process::Planner, (&name, folder.path()), &roster, &stop);
            let ports = planner::ports::Ports::open(&member.wire).expect("ports");
            let process = PlannerProcess::new(&member.config, ports).expect("a planner");
            let counts = &planner;
            let run = TickLoop::start(member).expect("ports");
            run.run(&mut Counted { process, counts })
        });
        let controlling = scope.spawn(|| {
            let member = member(Process::Controller, (&name, folder.path()), &roster, &stop);
            let ports = controller::ports::Ports::open(&member.wire).expect("ports");
            let mut run = TickLoop::start(member).expect("ports");
            let process = ControllerProcess::open(&mut run, ports).expect("a controller");
            let counts = &controller;
            run.run(&mut Counted { process, counts })
        });
        let done = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| drive(&mut rest)));
        stop.store(true, Ordering::Relaxed);
        planning.join().expect("planner").expect("planner");
        controlling.join().expect("controller").expect("controller");
        done.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    });
    drop((rest, wire));
    let paths = RunPaths::new(name);
    let _ = paths.clean_if_dead();
    paths.remove_dir();

    let read = |count: &AtomicU64| count.load(Ordering::Relaxed);
    let ticks = TICKS + WARM_UP;
    assert_eq!(
        (read(&planner.ticks), read(&controller.ticks)),
        (ticks, ticks)
    );
    assert!(
        done.planned > 9_000 && done.judged > 9_000 && done.expert > 3_000 && done.policy > 3_000,
        "{done:?}"
    );
    let swaps = TICKS / SWAP_TICKS;
    assert_eq!((done.versions, done.version), (swaps, swaps), "{done:?}");
    assert!(done.ready && done.metres > 1_000.0, "{done:?}");
    let counted = (read(&planner.allocations), read(&controller.allocations));
    assert_eq!(counted, (0, 0), "allocations in {TICKS} ticks");
}
