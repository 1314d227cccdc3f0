//! What the process does about policies between two ticks: the exchange with the
//! loader's mailbox, and in lockstep the wait for the learner.

use std::time::Duration;

use runtime::{Member, SetUpError, TickLoop};
use shm_config::message::Learning;
use shm_config::{Instant, Message};

use crate::ports::LearnerPorts;
use crate::{Controller, Exchanged, Loader, TickEnd};

/// Between two tries of a mailbox that is locked.
const RETRY: Duration = Duration::from_micros(50);
/// Interval at which the loader is polled before the first tick, ns.
const POLL_NS: u64 = 2_000_000;
/// How long the run's first policy may take to be loaded, ns: ONNX Runtime's
/// library takes a quarter of a second on an idle machine.
const LOAD_NS: u64 = 60_000_000_000;

/// The process's side of the loader.
pub struct PolicySwap {
    loader: Loader,
    end: TickEnd,
    learning: Option<Learner>,
}

/// A learner that is waited for.
struct Learner {
    ports: LearnerPorts,
    newest: Learning,
    /// Steps driven, in this run and in those that it goes on with; `None` until
    /// the learner has published how many there were.
    steps: Option<u64>,
    /// Steps of this controller.
    own_steps: u64,
    block_steps: u64,
    wait_ns: u64,
    is_silent: bool,
    awaited: Option<Awaited>,
}

/// What the next tick waits for.
#[derive(Clone, Copy)]
struct Awaited {
    /// The tick whose step the learner has to consider; `None` for its first message.
    step: Option<u64>,
    /// When the wait is over; set when it is first polled.
    until: Option<Instant>,
}

impl PolicySwap {
    /// Starts the loader and opens what is needed, before the process applies its
    /// real-time privileges.
    ///
    /// # Errors
    /// When the system gives no thread, or shared memory refuses.
    pub fn open(member: &Member) -> Result<Self, SetUpError> {
        let loader = Loader::start(&member.config, member.clock).map_err(|error| {
            SetUpError::Own(format!("cannot start the loader's thread: {error}"))
        })?;
        let learner = &member.config.learner;
        let learning = match member.config.run.is_lockstep() && learner.enabled {
            false => None,
            true => Some(Learner {
                ports: LearnerPorts::open(&member.wire)?,
                newest: Learning::default(),
                steps: None,
                own_steps: 0,
                block_steps: u64::from(learner.block_steps),
                wait_ns: (member.config.limits.learner_wait_s * 1e9) as u64,
                is_silent: false,
                // One that was killed in a block's updates makes them first, and the steps
                // that were driven meanwhile would have no policy.
                awaited: Some(Awaited {
                    step: None,
                    until: None,
                }),
            }),
        };
        Ok(Self {
            loader,
            end: TickEnd::default(),
            learning,
        })
    }

    /// Waits until the run's first policy is loaded, and adopts it: the first tick
    /// has it.
    ///
    /// # Errors
    /// When the policy is refused, or takes too long.
    pub fn begin(
        &mut self,
        run: &mut TickLoop,
        controller: &mut Controller,
    ) -> Result<(), SetUpError> {
        let until = run.now().after_ns(LOAD_NS);
        while !run.member.is_stopping() {
            run.telemetry.heartbeat(run.member.now());
            match self.loader.begun(Duration::from_nanos(POLL_NS)) {
                Some(Ok(())) => {
                    self.exchange_now(controller);
                    return Ok(());
                }
                Some(Err(why)) => return Err(SetUpError::Own(why)),
                None if run.now() >= until => {
                    return Err(SetUpError::Own("the policy takes too long to load".into()));
                }
                None => {}
            }
        }
        Ok(())
    }

    /// Adopts the mailbox's candidate, unless the mailbox is locked; returns whether it was
    /// free. Never waits.
    pub fn exchange(&mut self, controller: &mut Controller) -> bool {
        match self.end.exchange(self.loader.mailbox()) {
            Exchanged::Locked => false,
            Exchanged::Done(None) => true,
            Exchanged::Done(Some(candidate)) => {
                let tick = match self.end.has_ticked() {
                    true => controller.step().header.tick.saturating_add(1),
                    // The loader learns the number of the first tick when it is known.
                    false => 0,
                };
                controller.adopt(candidate, tick, &mut self.end);
                true
            }
        }
    }

    /// The same where there is time: the mailbox is locked for moving pointers only.
    /// Sleeps between two tries, since the loader has no priority on a shared core.
    fn exchange_now(&mut self, controller: &mut Controller) {
        while !self.exchange(controller) {
            std::thread::park_timeout(RETRY);
        }
    }

    /// After the tick's command is out: the weights in shadow.
    pub fn after_tick(&mut self, controller: &mut Controller) {
        self.end.count_tick(controller.step().header.tick);
        controller.run_canary(&mut self.end);
    }

    /// In lockstep with a learner, at the end of a block: the next tick waits until it has
    /// considered the last step, and until the loader has decided about what it
    /// published. So adoption happens at the same tick in every run.
    pub fn end_tick(&mut self, tick: u64) {
        let Some(learner) = &mut self.learning else {
            return;
        };
        // A learner that was restarted before this wait does not end it.
        let _ = learner.receive();
        if learner.count(tick) && !learner.is_silent {
            learner.awaited = Some(Awaited {
                step: Some(tick),
                until: None,
            });
        }
    }

    /// In lockstep with a learner: whether the next tick has to wait, before the first one
    /// for the learner's first message, after a block for [`PolicySwap::end_tick`]. What
    /// the learner published is adopted at the end of the wait.
    pub fn holds_tick(&mut self, now: Instant, controller: &mut Controller) -> bool {
        let Some(learner) = &mut self.learning else {
            return false;
        };
        let Some(mut awaited) = learner.awaited else {
            return false;
        };
        let until = *awaited.until.get_or_insert(now.after_ns(learner.wait_ns));
        let has_sent = learner.has_sent(&mut awaited);
        learner.awaited = Some(awaited);
        let is_done = has_sent && learner.newest.version <= self.loader.mailbox().decided();
        if !is_done && now < until {
            return true;
        }
        learner.is_silent |= !is_done;
        self.end_wait(controller);
        false
    }

    /// The next tick waits no longer.
    pub fn end_wait(&mut self, controller: &mut Controller) {
        if let Some(learner) = &mut self.learning
            && learner.awaited.take().is_some()
        {
            self.exchange_now(controller);
        }
    }
}

/// Which learner sent the newest message.
#[derive(PartialEq, Eq)]
enum Sender {
    /// The same as before, or none.
    Same,
    /// One that was started in place of the one before.
    Successor,
}

impl Learner {
    /// Counts the step of this tick. Returns whether it ends a block, as the
    /// learner counts them: a run that goes on may begin within one.
    fn count(&mut self, tick: u64) -> bool {
        self.own_steps += 1;
        let header = &self.newest.header;
        let steps = match (self.steps, header.sequence) {
            (Some(steps), _) => steps + 1,
            (None, 0) => return false,
            // Its first message is sent before it considers any step.
            (None, 1) => self.newest.steps + self.own_steps,
            (None, _) => {
                let ahead = tick.saturating_sub(header.tick);
                self.newest.steps + ahead.min(self.own_steps)
            }
        };
        self.steps = Some(steps);
        steps.is_multiple_of(self.block_steps)
    }

    /// It has sent what is waited for.
    fn has_sent(&mut self, awaited: &mut Awaited) -> bool {
        if self.receive() == Sender::Successor {
            // It never received the step: the wait would not end.
            awaited.step = None;
        }
        let header = &self.newest.header;
        match awaited.step {
            None => header.sequence > 0,
            // Its first message is of no step.
            Some(tick) => header.sequence > 1 && header.tick >= tick,
        }
    }

    fn receive(&mut self) -> Sender {
        self.ports.update_connections();
        let Some(learning) = self.ports.learning.newest(Message::check) else {
            return Sender::Same;
        };
        let before = std::mem::replace(&mut self.newest, learning)
            .header
            .producer;
        self.is_silent = false;
        match before != 0 && before != learning.header.producer {
            true => Sender::Successor,
            false => Sender::Same,
        }
    }
}
