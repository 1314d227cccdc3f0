//! The learner process: reads steps, learns, publishes policies.

use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use learner::ports::{OfferPorts, Ports};
use learner::session::{Block, Session};
use runtime::{Arguments, Member, Pulse, SetUpError, Tick, exit_code};
use shm_config::Instant;
use shm_config::message::{HealthState, Learning, Message, PolicyState, Step};
use shm_config::services::Process;
use shm_config::time::monotonic;

/// Learns from every step of a run, and offers the controller better weights
#[derive(Parser)]
#[command(name = "vlaps-learner", version)]
struct Cli {
    #[command(flatten)]
    arguments: Arguments,
}

/// How long the learner sleeps at most before it says how it does.
const NAP: Duration = Duration::from_millis(20);

fn main() -> ExitCode {
    exit_code(Process::Learner, learn(&Cli::parse().arguments))
}

/// The process between its ports and what learns.
struct Learner {
    ports: Ports,
    offers: OfferPorts,
    session: Session,
    /// What was last said of how far it is.
    said: Learning,
    /// The highest version that anybody has offered.
    offered: u64,
}

#[allow(clippy::disallowed_methods)] // a process entry point reads the clock
fn learn(arguments: &Arguments) -> Result<(), SetUpError> {
    let mut member = Member::join(Process::Learner, arguments)?;
    let folder = Path::new(&member.config.run.folder).join("learner");
    let session = Session::open(&member.config, &folder)
        .map_err(|error| SetUpError::Own(error.to_string()))?;
    let mut learner = Learner {
        ports: Ports::open(&member.wire)?,
        offers: OfferPorts::open(&member.wire)?,
        session,
        said: Learning {
            block_steps: u64::from(member.config.learner.block_steps),
            ..Learning::default()
        },
        offered: 0,
    };
    let mut pulse = Pulse::start(&member)?;
    member.claim_rights();
    pulse.set_rights(&member.rights);
    tracing::info!(
        algorithm = member.config.learner.algorithm.word(),
        steps = learner.session.driven(),
        folder = %folder.display(),
        "learns"
    );
    learner.ports.update_connections();
    learner.begin(&mut pulse);
    while !member.is_stopping() {
        learner.ports.bell.wait(NAP);
        pulse.beat(monotonic());
        learner.ports.update_connections();
        learner.hear();
        while let Some(step) = learner.ports.steps.receive() {
            let begun = monotonic();
            match step.check() {
                Ok(()) => learner.consider(&step, &mut pulse),
                Err(refusal) => {
                    member.wire.refuse(&refusal);
                    tracing::warn!(%refusal, "step refused");
                }
            }
            pulse.count_refused(&member.wire);
            pulse.health.state = HealthState::Running.code();
            pulse.health.header.tick = step.header.tick;
            pulse.count_tick(Tick {
                due: Instant(step.timings.commanded_ns),
                released: None,
                begun,
                done: monotonic(),
            });
            pulse.beat(monotonic());
        }
    }
    // The last steps of the run may still be on their way.
    while let Some(step) = learner.ports.steps.receive() {
        if step.check().is_ok() {
            learner.consider(&step, &mut pulse);
        }
    }
    learner.session.finish();
    let counts = learner.session.counts();
    tracing::info!(steps = counts.steps, lost = counts.lost, "ends");
    pulse.enter(HealthState::Finished, monotonic());
    Ok(())
}

impl Learner {
    /// Says that it is there, and offers what it knew when it was last here: a
    /// learner of a run that goes on is not waited for in vain. A block in whose
    /// updates its predecessor was killed is learnt first.
    #[allow(clippy::disallowed_methods)] // the process entry point reads the clock
    fn begin(&mut self, pulse: &mut Pulse) {
        self.said.steps = self.session.driven();
        self.hear();
        if self.session.is_due() {
            // It is there, and updates may take longer than a start may.
            pulse.enter(HealthState::Ready, monotonic());
            self.learn(pulse);
        } else if self.session.driven() > 0 {
            match self.session.policy_file() {
                Ok(policy) => self.offer(&policy),
                Err(refusal) => tracing::error!(%refusal, "no policy to begin with"),
            }
        }
        self.ports.learning.send(&mut self.said);
        pulse.enter(HealthState::Ready, monotonic());
    }

    /// Takes in what the controller says of the offers.
    fn hear(&mut self) {
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

    fn consider(&mut self, step: &Step, pulse: &mut Pulse) {
        self.session.push(step);
        self.said.header.tick = step.header.tick;
        self.said.header.episode = step.header.episode;
        self.said.header.taken_ns = step.header.taken_ns;
        self.said.steps = self.session.driven();
        if !self.session.is_due() {
            self.ports.learning.send_quietly(&mut self.said);
            return;
        }
        self.learn(pulse);
        self.ports.learning.send(&mut self.said);
    }

    #[allow(clippy::disallowed_methods)] // the process entry point reads the clock
    fn learn(&mut self, pulse: &mut Pulse) {
        match self.session.learn(|| pulse.beat(monotonic())) {
            Ok(block) => self.publish(&block),
            Err(refusal) => tracing::error!(%refusal, "the block's policy is not published"),
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
        self.hear();
        let version = self.offered.max(self.said.version) + 1;
        self.offers.update_connections();
        if self
            .offers
            .weights
            .offer(version, policy::sha256(policy), policy)
        {
            self.said.version = version;
            self.offered = version;
        } else {
            tracing::error!(
                bytes = policy.len(),
                "shared memory has no room for the policy"
            );
        }
    }
}
