//! The planner process: a plan for every observation whose turn it is.

use std::cell::Cell;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use planner::Planner;
use planner::ports::Ports;
use runtime::{Arguments, Deadline, Member, Pulse, SetUpError, Skipped, Tick, exit_code};
use shm_config::config::Late;
use shm_config::message::{Health, HealthState, Observation, Part, Plan, PlanOutcome};
use shm_config::services::Process;
use shm_config::time::monotonic;
use shm_config::{Instant, PlanTurns, RunGrid};

/// Answers observations with plans, at its own rate
#[derive(Parser)]
#[command(name = "vlaps-planner", version)]
struct Cli {
    #[command(flatten)]
    arguments: Arguments,
}

/// How long the planner sleeps at most before it says how it does.
const NAP: Duration = Duration::from_millis(20);

/// Accounts for every turn: planned, or skipped.
struct Slots {
    period_ns: u64,
}

impl Slots {
    /// A plan for the observation that was due then. Those since the one before
    /// that got no plan are skipped. Another world's grid may be shifted: whole
    /// periods count, rounded.
    fn account(&self, due: Instant, health: &mut Health) -> Skipped {
        let mut count = 0;
        if health.ticks == 1 {
            health.first_scheduled_ns = due.0;
        } else {
            let late_ns = due.since_ns(Instant(health.next_scheduled_ns));
            count = (late_ns + self.period_ns / 2) / self.period_ns;
        }
        health.skipped += count;
        health.next_scheduled_ns = due.after_ns(self.period_ns).0;
        Skipped {
            newest: Instant(due.0.saturating_sub(self.period_ns)),
            period_ns: self.period_ns,
            count,
        }
    }
}

/// The plan is over its deadline: does with it what `deadlines.planner` says.
/// Returns whether it goes out.
fn answer_late(plan: &mut Plan, policy: Late) -> bool {
    if policy == Late::Brake {
        plan.outcome = PlanOutcome::Blocked.code();
        (plan.waypoint_count, plan.action_count) = (0, 0);
    }
    policy != Late::Skip
}

fn main() -> ExitCode {
    exit_code(Process::Planner, plan(&Cli::parse().arguments))
}

#[allow(clippy::disallowed_methods)] // a process entry point reads the clock
fn plan(arguments: &Arguments) -> Result<(), SetUpError> {
    let mut member = Member::join(Process::Planner, arguments)?;
    let mut ports = Ports::open(&member.wire)?;
    let mut pulse = Pulse::start(&member)?;
    let mut planner =
        Planner::new(&member.config).map_err(|error| SetUpError::Own(error.to_string()))?;
    let mut plan = Box::<Plan>::default();
    let lockstep = member.config.run.is_lockstep();
    let grid = RunGrid::of(&member.config);
    // A tick begins when its observation is there, before that is checked.
    let came = Cell::new(Instant(0));
    let door = |observation: &Observation| {
        came.set(monotonic());
        grid.admit(observation, came.get())
    };
    let mut turns = PlanTurns::every(member.config.plan_ticks());
    let period_ns = member.config.run.period_ns() * member.config.plan_ticks();
    let slots = Slots { period_ns };
    // At a rate below the run's each episode begins its turns anew, and in lockstep
    // its instants are none of the machine's clock.
    let keeps_grid = !lockstep && member.config.tick_ns(Process::Planner).is_some();
    member.claim_rights();
    pulse.set_rights(&member.rights);
    pulse.enter(HealthState::Ready, monotonic());
    while !member.is_stopping() {
        if let Some(observation) = ports.observations.newest(door)
            // Between two turns the controller moves the last plan on.
            && turns.take(&observation.header)
        {
            let begun = came.get();
            pulse.begin(begun);
            let now = match lockstep {
                true => observation.header.taken(),
                false => begun,
            };
            pulse.end(Part::Admit, monotonic());
            let prepared = || pulse.end(Part::Grid, monotonic());
            planner.plan_in_parts(&observation, &mut plan, prepared);
            let planned = monotonic();
            pulse.end(Part::Search, planned);
            plan.planning_ns = planned.since_ns(begun);
            let is_late = !lockstep && planned.0 > observation.scheduled_ns + period_ns;
            if !is_late || answer_late(&mut plan, member.config.deadlines.planner) {
                ports.plans.send(&mut plan);
            }
            let done = monotonic();
            pulse.end(Part::Send, done);
            pulse.count_tick(Tick {
                due: Instant(observation.scheduled_ns),
                released: Some(observation.published()),
                begun,
                done,
            });
            let age_ns = now.since_ns(observation.header.taken());
            pulse.timing.observation_age.record(age_ns);
            let due = match lockstep {
                // A restarted world begins its clock anew; the account goes on.
                true => {
                    let next_due = Instant(pulse.health.next_scheduled_ns);
                    observation.header.taken().max(next_due)
                }
                false => Instant(observation.scheduled_ns),
            };
            let skipped = slots.account(due, &mut pulse.health);
            if keeps_grid {
                pulse.record_skipped(skipped, begun);
            }
            if !lockstep {
                pulse.note_deadline(Deadline {
                    tick: observation.header.tick,
                    deadline: Instant(observation.scheduled_ns + period_ns),
                    done,
                    skipped: if keeps_grid { skipped.count } else { 0 },
                    period_ns,
                });
            }
            let health = &mut pulse.health;
            health.header.tick = observation.header.tick;
            health.late += u64::from(done.0 > observation.scheduled_ns + period_ns);
            health.state = HealthState::Running.code();
        }
        pulse.count_refused(&member.wire);
        pulse.beat(monotonic());
        ports.update_connections();
        ports.bell.wait(NAP);
    }
    pulse.enter(HealthState::Finished, monotonic());
    Ok(())
}
