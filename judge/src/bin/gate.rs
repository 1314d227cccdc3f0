//! The gate process: asks a judge at its own pace and publishes advice.

use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use gate::{AtOnce, Counsel, Rules};
use process::{Arguments, Member, Pulse, SetUpError, exit_code};
use shm_config::message::{HealthState, Message};
use shm_config::services::{ADVICE, Process, STEP};
use shm_config::time::monotonic;

/// Asks a judge which of two proposals is safer, and publishes its advice
#[derive(Parser)]
#[command(name = "vlaps-gate", version)]
struct Cli {
    #[command(flatten)]
    arguments: Arguments,
}

/// How long the gate sleeps at most before it says how it does.
const NAP: Duration = Duration::from_millis(20);

fn main() -> ExitCode {
    exit_code(Process::Gate, advise(&Cli::parse().arguments))
}

#[allow(clippy::disallowed_methods)] // a process entry point reads the clock
fn advise(arguments: &Arguments) -> Result<(), SetUpError> {
    let mut member = Member::join(Process::Gate, arguments)?;
    let bell = member.wire.doorbell(Process::Gate)?;
    let mut steps = member.wire.latest(STEP)?;
    let mut port = member.wire.publisher(ADVICE)?;
    let mut pulse = Pulse::start(&member)?;
    let config = &member.config;
    let rules = Rules::new(config.vehicle, config.judge);
    let mut counsel = Counsel::new(&config.gate, Box::new(AtOnce::new(rules)));
    let lockstep = config.run.is_lockstep();
    member.claim_rights();
    pulse.set_rights(&member.rights);
    pulse.enter(HealthState::Ready, monotonic());
    while !member.is_stopping() {
        bell.wait(NAP);
        let begun = monotonic();
        if let Some(step) = steps.newest() {
            match step.check() {
                Ok(()) => {
                    let now = if lockstep {
                        step.header().taken()
                    } else {
                        begun
                    };
                    let mut advice = counsel.consider(&step, now);
                    port.send(&mut advice);
                    pulse.health.header.tick = step.header().tick;
                    pulse.health.state = HealthState::Running.code();
                    let timings = &step.timings;
                    pulse.count_tick(
                        begun.0.saturating_sub(timings.commanded_ns),
                        monotonic().since_ns(begun),
                    );
                }
                Err(refusal) => {
                    pulse.health.refused += 1;
                    tracing::warn!(%refusal, "step refused");
                }
            }
        }
        pulse.beat(begun);
        port.tend();
        steps.tend();
    }
    pulse.enter(HealthState::Finished, monotonic());
    Ok(())
}
