//! A tick without an operating system: observation to plan, the policy's proposal, the
//! verdicts and the command, in memory of the caller's.
//!
//! `.ci/run` builds it with the feature `alone` as a static library. Its panic handler
//! is then the only one, which the compiler refuses where any crate links `std`; and it
//! has no allocator, which the compiler refuses where any crate links `alloc`.

#![no_std]
#![cfg(feature = "alone")]

use controller::{AdmittedAt, Arbiter, ArbiterConfig, Inputs, PolicyAnswer};
use planner::{GridWords, Kinodynamic, Path, PlannerConfig, PoseSearch, RrtStar, Search};
use policy::{BLOCK, Forward};
use shm_config::Instant;
use shm_config::message::{FEATURES, Intent, Observation, Plan, Stage, Step};
use shm_config::settings::{self, OutOfRange};
use vehicle::{Action, Vehicle};

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {
        core::hint::spin_loop();
    }
}

/// The weights of a layer in read-only memory.
pub type Blocks = &'static [[f32; BLOCK]];

/// Planner, policy and controller, and the message between them.
pub struct Tick {
    planner: RrtStar,
    policy: Forward<'static, Blocks>,
    arbiter: Arbiter,
    plan: Plan,
}

impl Tick {
    /// In memory that the caller gives for ever.
    ///
    /// # Errors
    /// The first number of the settings that is outside its limits.
    pub fn new(
        config: ArbiterConfig,
        policy: Forward<'static, Blocks>,
        memory: (&'static mut Search, &'static mut GridWords),
    ) -> Result<Self, OutOfRange> {
        Ok(Self {
            planner: RrtStar::within(PlannerConfig::default(), memory.0, memory.1)?,
            policy,
            arbiter: Arbiter::new(config),
            plan: Plan::default(),
        })
    }

    /// One observation to the step that answers it.
    pub fn answer(&mut self, observation: &Observation, tick: u64, now: Instant) -> &Step {
        self.planner.plan(observation, &mut self.plan);
        let inputs = Inputs {
            observation: (*observation).into(),
            plan: self.plan.into(),
            admitted: AdmittedAt::default(),
            ..Inputs::default()
        };
        self.arbiter.admit(&inputs, now);
        let mut features = [0.0; FEATURES];
        let proposal = observation.features(&mut features).map(|features| {
            let [steer, pedal] = self.policy.infer(features).map(f64::from);
            Action { steer, pedal }.clamped()
        });
        let answer = PolicyAnswer {
            stage: Stage::Active,
            proposal,
            weights: (1, 1),
        };
        self.arbiter.decide(tick, now, Intent::Drive, &answer);
        self.arbiter.step()
    }
}

/// The planner over poses, likewise.
///
/// # Errors
/// The first number of the settings that is outside its limits.
pub fn kinodynamic(
    memory: (&'static mut PoseSearch, &'static mut Path),
    words: &'static mut GridWords,
) -> Result<Kinodynamic, OutOfRange> {
    let settings = settings::Kinodynamic::default();
    let car = Vehicle::default();
    Kinodynamic::within((PlannerConfig::default(), settings, car), memory, words)
}
