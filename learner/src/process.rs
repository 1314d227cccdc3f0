//! The learner process: reads steps, learns, publishes policies.

use std::path::Path;

use runtime::{HEARTBEAT_MAX, Member, SetUpError, Telemetry, Tick};
use shm_config::Instant;
use shm_config::message::{HealthState, Learning, Message, PolicyState, Step};
use shm_config::time::Clock;

use crate::ports::{OfferPorts, Ports};
use crate::session::{Block, Session};

/// The learner's process: its ports and its session.
struct Learner {
    ports: Ports,
    offers: OfferPorts,
    clock: Clock,
    session: Session,
    /// The newest message that was published.
    progress: Learning,
    /// The highest version offered so far.
    offered: u64,
}

/// Runs the learner until it is stopped.
///
/// # Errors
/// When shared memory, the configuration or the experiment's folder refuses.
pub fn run(mut member: Member, ports: Ports, offers: OfferPorts) -> Result<(), SetUpError> {
    let folder = Path::new(&member.config.run.folder).join("learner");
    let session = Session::open(&member.config, &folder)
        .map_err(|error| SetUpError::Own(error.to_string()))?;
    let mut learner = Learner {
        ports,
        offers,
        clock: member.clock,
        session,
        progress: Learning {
            block_steps: u64::from(member.config.learner.block_steps),
            ..Learning::default()
        },
        offered: 0,
    };
    let mut telemetry = Telemetry::start(&member)?;
    member.apply_privileges();
    telemetry.set_privileges(&member.privileges);
    tracing::info!(
        algorithm = member.config.learner.algorithm.word(),
        steps = learner.session.driven(),
        folder = %folder.display(),
        "learns"
    );
    learner.ports.update_connections();
    learner.begin(&mut telemetry);
    while !member.is_stopping() {
        learner.ports.bell.wait(HEARTBEAT_MAX);
        telemetry.heartbeat(member.now());
        learner.ports.update_connections();
        learner.read_status();
        while let Some(step) = learner.ports.steps.receive() {
            let begun = member.now();
            match step.check() {
                Ok(()) => learner.consider(&step, &mut telemetry),
                Err(refusal) => {
                    member.wire.refuse(&refusal);
                    tracing::warn!(%refusal, "step refused");
                }
            }
            telemetry.count_refused(&member.wire);
            telemetry.health.state = HealthState::Running.code();
            telemetry.health.header.tick = step.header.tick;
            telemetry.count_tick(Tick {
                due: Instant(step.timings.commanded_ns),
                released: None,
                begun,
                done: member.now(),
            });
            telemetry.heartbeat(member.now());
        }
    }
    // The last steps of the run may still arrive.
    while let Some(step) = learner.ports.steps.receive() {
        if step.check().is_ok() {
            learner.consider(&step, &mut telemetry);
        }
    }
    learner.session.finish();
    let counts = learner.session.counts();
    tracing::info!(steps = counts.steps, lost = counts.lost, "ends");
    telemetry.enter(HealthState::Finished, member.now());
    Ok(())
}

impl Learner {
    /// Publishes the first message, and offers the policy of the experiment so far,
    /// because in lockstep the controller waits for it. If an earlier learner was
    /// killed during the updates of a block, the block is learnt first.
    fn begin(&mut self, telemetry: &mut Telemetry) {
        self.progress.steps = self.session.driven();
        self.read_status();
        if self.session.is_due() {
            // These updates may take longer than the limit for a start.
            telemetry.enter(HealthState::Ready, (self.clock)());
            self.learn(telemetry);
        } else if self.session.driven() > 0 {
            match self.session.policy_file() {
                Ok(policy) => self.offer(&policy),
                Err(refusal) => tracing::error!(%refusal, "cannot export the first policy"),
            }
        }
        self.ports.learning.send(&mut self.progress);
        telemetry.enter(HealthState::Ready, (self.clock)());
    }

    /// Reads what the controller publishes about the offers.
    fn read_status(&mut self) {
        let Some(status) = self.ports.statuses.newest(Message::check) else {
            return;
        };
        self.offered = self.offered.max(status.offered_version);
        let reason = status.refusal();
        match status.state() {
            PolicyState::Refused => {
                tracing::warn!(version = status.offered_version, %reason, "refused");
            }
            PolicyState::RolledBack => {
                tracing::warn!(version = status.offered_version, %reason, "rolled back");
            }
            PolicyState::Empty | PolicyState::Shadow | PolicyState::Ready => {}
        }
    }

    fn consider(&mut self, step: &Step, telemetry: &mut Telemetry) {
        self.session.push(step);
        self.progress.header.tick = step.header.tick;
        self.progress.header.episode = step.header.episode;
        self.progress.header.taken_ns = step.header.taken_ns;
        self.progress.steps = self.session.driven();
        if !self.session.is_due() {
            self.ports.learning.send_quietly(&mut self.progress);
            return;
        }
        self.learn(telemetry);
        self.ports.learning.send(&mut self.progress);
    }

    fn learn(&mut self, telemetry: &mut Telemetry) {
        let clock = self.clock;
        match self.session.learn(|| telemetry.heartbeat(clock())) {
            Ok(block) => self.publish(&block),
            Err(refusal) => tracing::error!(%refusal, "the policy of the block is not published"),
        }
    }

    fn publish(&mut self, block: &Block) {
        let losses = &block.losses;
        tracing::info!(
            steps = block.steps,
            actor = losses.actor,
            imitation = losses.imitation,
            critic = losses.critic,
            "block"
        );
        self.offer(&block.policy);
    }

    fn offer(&mut self, policy: &[u8]) {
        self.read_status();
        let version = self.offered.max(self.progress.version) + 1;
        self.offers.update_connections();
        if self
            .offers
            .weights
            .offer(version, policy::sha256(policy), policy)
        {
            self.progress.version = version;
            self.offered = version;
        } else {
            tracing::error!(
                bytes = policy.len(),
                "shared memory has no room for the policy"
            );
        }
    }
}
