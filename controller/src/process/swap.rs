//! What the process does about policies between two ticks: the exchange with the
//! loader's mailbox, and in lockstep the wait for the learner.

use std::time::Duration;

use runtime::{Member, SetUpError, TickLoop};
use shm_config::Message;
use shm_config::message::Learning;

use crate::ports::LearnerPorts;
use crate::{Controller, Exchanged, Loader, TickEnd};

/// Between two tries of a mailbox that is locked.
const RETRY: Duration = Duration::from_micros(50);
/// Interval at which learner and loader are polled, in lockstep, ns.
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
                wait_ns: (shm_config::config::Learner::LOCKSTEP_WAIT_S * 1e9) as u64,
                is_silent: false,
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

    /// In lockstep with a learner, before the first tick: waits for its first message,
    /// and for the loader's decision about the weights that it begins with. One that was
    /// killed in a block's updates makes them first, and the steps that were driven
    /// meanwhile would have no policy.
    pub fn await_learner_start(&mut self, run: &mut TickLoop, controller: &mut Controller) {
        let has_begun = |learner: &mut Learner| {
            let _ = learner.receive();
            learner.newest.header.sequence > 0
        };
        match &self.learning {
            Some(learner) if !learner.is_silent && learner.newest.header.sequence == 0 => {
                self.wait(run, controller, has_begun);
            }
            Some(_) | None => {}
        }
    }

    /// In lockstep with a learner, at the end of a block: waits until it has
    /// considered the last step, and until the loader has decided about what it
    /// published. So adoption happens at the same tick in every run.
    pub fn await_learner(&mut self, run: &mut TickLoop, controller: &mut Controller) {
        let Some(learner) = &mut self.learning else {
            return;
        };
        // A learner that was restarted before this wait does not end it.
        let _ = learner.receive();
        let tick = controller.step().header.tick;
        let is_end = learner.count(tick);
        if !is_end || learner.is_silent {
            return;
        }
        let mut is_successor = false;
        let has_considered = |learner: &mut Learner| {
            // It never received the step that this wait is for: the wait would not end.
            is_successor |= learner.receive() == Sender::Successor;
            is_successor || learner.has_considered(tick)
        };
        self.wait(run, controller, has_considered);
    }

    /// Waits for that of the learner, and for the loader's decision about what it
    /// published; adopts it.
    fn wait(
        &mut self,
        run: &mut TickLoop,
        controller: &mut Controller,
        mut is_done: impl FnMut(&mut Learner) -> bool,
    ) {
        let Some(learner) = &mut self.learning else {
            return;
        };
        let until = run.now().after_ns(learner.wait_ns);
        while !run.member.is_stopping() {
            if is_done(learner) && learner.newest.version <= self.loader.mailbox().decided() {
                break;
            }
            let now = run.now();
            if now >= until {
                learner.is_silent = true;
                break;
            }
            run.wait_alive(until.min(now.after_ns(POLL_NS)), now);
        }
        self.exchange_now(controller);
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

    /// The learner has considered the step of this tick; its first message is of none.
    fn has_considered(&self, tick: u64) -> bool {
        self.newest.header.sequence > 1 && self.newest.header.tick >= tick
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
