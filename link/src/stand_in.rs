//! The processes that stand for a judge or a learner of another machine.
//!
//! The supervisor starts one of them in the place of the gate or of the learner: it is on
//! the roster, has a heartbeat, is restarted, and has no priority. It reads what that process
//! reads and sends it over the network; what comes back passes the door and is published as
//! that process publishes it. So no other process of the set knows that a network exists, and
//! silence is what it always was: advice expires and the expert drives.

use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use runtime::{Arguments, Member, SetUpError, Telemetry, Tick};
use shm_config::Instant;
use shm_config::Message;
use shm_config::message::{
    Advice, Foresight, Frame, FrameRequest, HealthState, Learning, PolicyStatus, Step, Weights,
};
use shm_config::services::{
    ADVICE, FORESIGHT, FRAME, FRAME_REQUEST, LEARNING, POLICY_STATUS, Process, STEP, WEIGHTS,
};
use shm_config::time::monotonic;

use crate::carrier::use_one_thread;
use crate::dating::Dating;
use crate::host::{Event, Seats};
use crate::keys::Claim;
use crate::pace::{Owed, Pace, Paced, newest};
use crate::refusal::Reason;
use crate::role::{Role, RowId};
use crate::rows::{SignedPolicy, bytes_of, message_of};
use crate::station::Station;

/// Longest wait for a step before the network is read: advice waits this long at most.
const TURN: Duration = Duration::from_millis(1);
/// Least time between two requests for pictures, ns on the run's clock: a question needs one,
/// and a picture costs the world's render thread some milliseconds.
const REQUEST_NS: u64 = 100_000_000;
/// Least time between two policies of a learner in real time, ns: the controller loads and
/// checks each. In lockstep the run waits for both.
const OFFER_NS: u64 = 1_000_000_000;

shm_config::ports! {
    /// What stands for a judge reads and publishes.
    pub struct JudgePorts of Gate with bell {
        /// The newest record of a tick.
        steps: newest STEP: Step,
        /// Pictures.
        frames: newest FRAME: Frame,
        /// What would follow.
        foresights: newest FORESIGHT: Foresight,
        /// Advice.
        advices: write ADVICE: Advice,
        /// Requests for pictures.
        requests: write FRAME_REQUEST: FrameRequest,
    }
}

shm_config::ports! {
    /// What stands for a learner reads and publishes.
    pub struct LearnerPorts of Learner with bell {
        /// The record of each tick.
        steps: read STEP: Step,
        /// The status of offers.
        statuses: newest POLICY_STATUS: PolicyStatus,
        /// The learner's progress.
        learning: write LEARNING: Learning,
        /// Its policies.
        weights: write WEIGHTS: Weights,
    }
}

/// The instant, and the date, s since 1970.
#[allow(clippy::disallowed_methods)] // process entry points read the clocks
pub fn clocks() -> (Instant, u64) {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    (monotonic(), since.map_or(0, |since| since.as_secs()))
}

/// What both have in common.
struct Common {
    member: Member,
    telemetry: Telemetry,
    station: Station,
}

impl Common {
    fn open(process: Process, role: Role, arguments: &Arguments) -> Result<Self, SetUpError> {
        use_one_thread().map_err(SetUpError::Own)?;
        #[allow(clippy::disallowed_methods)] // a process entry point chooses the clock
        let member = Member::join(process, arguments, monotonic)?;
        let address = member
            .config
            .link
            .of(process)
            .map(|(_, address)| address.to_string());
        let address = address.ok_or_else(|| {
            SetUpError::Own(format!("link.{role} is empty: no address to listen at"))
        })?;
        let seats = Seats::One(role);
        let station = Station::open(&member.config, seats, &address, member.now());
        let station = station.map_err(SetUpError::Own)?;
        let telemetry = Telemetry::start(&member)?;
        tracing::info!(address, role = role.word(), "waits for a peer");
        Ok(Self {
            member,
            telemetry,
            station,
        })
    }

    fn ready(&mut self) {
        self.member.apply_privileges();
        self.telemetry.set_privileges(&self.member.privileges);
        self.telemetry.enter(HealthState::Ready, self.member.now());
    }

    fn count(&mut self, step: &Step, begun: Instant) {
        self.telemetry.health.header.tick = step.header.tick;
        self.telemetry.health.state = HealthState::Running.code();
        self.telemetry.count_tick(Tick {
            due: Instant(step.timings.commanded_ns),
            released: None,
            begun,
            done: self.member.now(),
        });
    }

    fn end_turn(&mut self) {
        self.station.send(clocks());
        self.telemetry.count_refused(&self.member.wire);
        self.telemetry.heartbeat(self.member.now());
    }

    fn close(mut self) {
        self.station.close(self.member.now());
        self.telemetry
            .enter(HealthState::Finished, self.member.now());
    }

    /// Publishes the newest advice that passes its door: of advice that comes late, many
    /// come in one turn, and only the newest is of use.
    fn advise(
        &mut self,
        events: &mut Vec<Event>,
        ports: &mut JudgePorts,
        (dating, now): (&Dating, Instant),
    ) {
        let Some(row) = RowId::of(ADVICE.name) else {
            return;
        };
        let (advices, over) = newest(events, row);
        self.station.host.refused.add(Reason::Flooded, over);
        for (older, bytes) in (1..=advices.len()).rev().zip(&advices) {
            let dated = message_of::<Advice>(bytes).and_then(|mut advice| {
                dating.date(&mut advice, now)?;
                Ok(advice)
            });
            match dated {
                Ok(mut advice) => {
                    ports.advices.send(&mut advice);
                    self.station.superseded += older as u64 - 1;
                    return;
                }
                Err(reason) => self.refuse(reason),
            }
        }
    }

    /// Offers the policy whose time has come.
    fn offer_due(&mut self, ports: &mut LearnerPorts, offers: &mut Offers, now: Instant) {
        if let Some((claim, bytes)) = offers.take_due(now)
            && let Err(reason) = offer(ports, &claim, &bytes)
        {
            self.refuse(reason);
        }
    }

    /// Counts a message that did not pass a door.
    fn refuse(&mut self, reason: Reason) {
        self.station.host.refused.count(reason);
    }
}

/// The policy that waits for its time.
type Offers = Paced<(Claim, Arc<[u8]>)>;

fn row(service: &str) -> Result<RowId, SetUpError> {
    RowId::of(service).ok_or_else(|| SetUpError::Own(format!("{service} may not leave")))
}

/// Stands for a judge until the run stops.
///
/// # Errors
/// When the process cannot be set up.
pub fn judge(arguments: &Arguments) -> Result<(), SetUpError> {
    let mut common = Common::open(Process::Gate, Role::Judge, arguments)?;
    let mut ports = JudgePorts::open(&common.member.wire)?;
    let mut dating = Dating::new(&common.member.config.gate);
    let rows = [row(STEP.name)?, row(FRAME.name)?, row(FORESIGHT.name)?];
    let lockstep = common.member.config.run.is_lockstep();
    let (mut run_now, mut requests) = (Instant(0), Pace::new(REQUEST_NS));
    common.ready();
    while !common.member.is_stopping() {
        ports.bell.wait(TURN);
        let begun = common.member.now();
        if let Some(step) = ports.steps.newest(Message::check) {
            dating.note(&step);
            run_now = step.header.taken();
            common.station.host.push(rows[0], bytes_of(&step));
            common.count(&step, begun);
        }
        let frame = ports.frames.visit(|frame| match frame.check() {
            Ok(()) => Some(bytes_of(frame)),
            Err(_) => None,
        });
        if let Some(bytes) = frame.flatten() {
            common.station.host.push(rows[1], bytes);
        }
        if let Some(foresight) = ports.foresights.newest(Message::check) {
            common.station.host.push(rows[2], bytes_of(&foresight));
        }
        let now = match lockstep {
            true => run_now,
            false => begun,
        };
        let mut events = common.station.receive(clocks());
        common.advise(&mut events, &mut ports, (&dating, now));
        for event in events {
            let Event::Message(_, _, bytes) = event else {
                continue;
            };
            let done = message_of::<FrameRequest>(&bytes).and_then(|mut request| {
                requests.take(now)?;
                ports.requests.send(&mut request);
                Ok(())
            });
            if let Err(reason) = done {
                common.refuse(reason);
            }
        }
        common.end_turn();
        ports.update_connections();
    }
    common.close();
    Ok(())
}

/// Stands for a learner until the run stops.
///
/// # Errors
/// When the process cannot be set up.
pub fn learner(arguments: &Arguments) -> Result<(), SetUpError> {
    let mut common = Common::open(Process::Learner, Role::Learner, arguments)?;
    let mut ports = LearnerPorts::open(&common.member.wire)?;
    let rows = [row(STEP.name)?, row(POLICY_STATUS.name)?];
    let mut lost = 0;
    let mut owed = Owed::default();
    let mut offers = Offers::new(match common.member.config.run.is_lockstep() {
        true => 0,
        false => OFFER_NS,
    });
    common.ready();
    while !common.member.is_stopping() {
        ports.bell.wait(TURN);
        while let Some(step) = ports.steps.receive() {
            let begun = common.member.now();
            match step.check() {
                Ok(()) => {
                    common.station.host.push(rows[0], bytes_of(&step));
                    common.count(&step, begun);
                    owed.add();
                }
                Err(refusal) => common.member.wire.refuse(&refusal),
            }
        }
        if ports.steps.lost() > lost {
            tracing::warn!(
                steps = ports.steps.lost() - lost,
                "lost before they were read"
            );
            lost = ports.steps.lost();
        }
        if let Some(status) = ports.statuses.newest(Message::check) {
            common.station.host.push(rows[1], bytes_of(&status));
        }
        let now = common.member.now();
        for event in common.station.receive(clocks()) {
            let (claim, row, bytes) = match event {
                Event::Message(claim, row, bytes) => (claim, row, bytes),
                // A learner's first message answers no step.
                Event::Joined(_) => {
                    owed.add();
                    continue;
                }
                _ => continue,
            };
            if row.service() == Some(LEARNING.name) {
                let taken = owed.take().and_then(|()| message_of::<Learning>(&bytes));
                match taken {
                    Ok(learning) => {
                        ports.learning.pass_on(&learning);
                    }
                    Err(reason) => common.refuse(reason),
                }
                continue;
            }
            let replaced = offers.put((claim, bytes));
            common.station.superseded += u64::from(replaced.is_some());
            common.offer_due(&mut ports, &mut offers, now);
        }
        common.offer_due(&mut ports, &mut offers, now);
        common.end_turn();
        ports.update_connections();
    }
    common.close();
    Ok(())
}

fn offer(ports: &mut LearnerPorts, claim: &Claim, bytes: &[u8]) -> Result<(), Reason> {
    let policy = SignedPolicy::of(bytes, claim.run, &claim.signer)?;
    let sent = ports
        .weights
        .offer(policy.version, policy.sha256, policy.file);
    tracing::info!(
        version = policy.version,
        bytes = policy.file.len(),
        sent,
        "a policy, signed by the learner's key"
    );
    Ok(())
}
