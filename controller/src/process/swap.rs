//! What the process does about policies between two ticks: over the desk and
//! back, and in lockstep the wait for the learner.

use std::time::Duration;

use controller::ports::LearnerPorts;
use controller::{Controller, Hand, Loader, Look};
use runtime::{Member, Pulse, SetUpError};
use shm_config::message::Learning;
use shm_config::time::monotonic;
use shm_config::wire::Doorbell;
use shm_config::{Instant, Message};

/// Between two looks at a desk that somebody holds.
const MOMENT: Duration = Duration::from_micros(50);
/// From look to look at the learner and the loader, in lockstep.
const NAP: Duration = Duration::from_millis(2);
/// How long what the run begins with may take to be loaded, ns: ONNX Runtime's
/// library takes a quarter of a second on an idle machine.
const BEGIN_NS: u64 = 60_000_000_000;

/// The process's side of the loader.
pub struct Handover {
    loader: Loader,
    hand: Hand,
    learning: Option<Learner>,
}

/// A learner that is waited for.
struct Learner {
    ports: LearnerPorts,
    newest: Learning,
    /// Steps driven, in this run and in those that it goes on with; `None` until
    /// the learner has said how many there were.
    steps: Option<u64>,
    /// Steps of this controller.
    own_steps: u64,
    block_steps: u64,
    wait_ns: u64,
    is_silent: bool,
}

impl Handover {
    /// Opens what is needed, with the loader at work already.
    pub fn open(member: &Member, loader: Loader) -> Result<Self, SetUpError> {
        let learner = &member.config.learner;
        let learning = match member.config.run.is_lockstep() && learner.enabled {
            false => None,
            true => Some(Learner {
                ports: LearnerPorts::open(&member.wire)?,
                newest: Learning::default(),
                steps: None,
                own_steps: 0,
                block_steps: u64::from(learner.block_steps),
                wait_ns: (learner.lockstep_wait_s * 1e9) as u64,
                is_silent: false,
            }),
        };
        Ok(Self {
            loader,
            hand: Hand::default(),
            learning,
        })
    }

    /// Waits until what the run begins with is loaded, and adopts it: the first
    /// tick has it.
    #[allow(clippy::disallowed_methods)] // the process entry point reads the clock
    pub fn begin(
        &mut self,
        controller: &mut Controller,
        member: &Member,
        pulse: &mut Pulse,
    ) -> Result<(), SetUpError> {
        let until = monotonic().after_ns(BEGIN_NS);
        while !member.is_stopping() {
            pulse.beat(monotonic());
            match self.loader.begun(NAP) {
                Some(Ok(())) => {
                    self.take(controller);
                    return Ok(());
                }
                Some(Err(why)) => return Err(SetUpError::Own(why)),
                None if monotonic() >= until => {
                    return Err(SetUpError::Own("the policy takes too long to load".into()));
                }
                None => {}
            }
        }
        Ok(())
    }

    /// Takes up what lies on the desk, if nobody holds it now. Never waits.
    pub fn look(&mut self, controller: &mut Controller) -> bool {
        match self.hand.look(self.loader.exchange()) {
            Look::Taken => false,
            Look::Seen(None) => true,
            Look::Seen(Some(offer)) => {
                let tick = match self.hand.has_ticked() {
                    true => controller.step().header.tick.saturating_add(1),
                    // The loader is told the number of the first tick when it is known.
                    false => 0,
                };
                controller.adopt(offer, tick, &mut self.hand);
                true
            }
        }
    }

    /// The same where there is time: the desk is held for moving pointers only. Asleep
    /// between two looks, since who holds it has no rights to a core they share.
    fn take(&mut self, controller: &mut Controller) {
        while !self.look(controller) {
            std::thread::park_timeout(MOMENT);
        }
    }

    /// After the tick's command is out: the shadow's turn.
    pub fn after_tick(&mut self, controller: &mut Controller) {
        self.hand.count_tick(controller.step().header.tick);
        controller.try_policies(&mut self.hand);
    }

    /// In lockstep with a learner, before the first tick: waits until it has spoken,
    /// and until the loader has decided about what it begins with. One that was
    /// killed in a block's updates makes them first, and the steps that were driven
    /// meanwhile would have no policy.
    pub fn await_first_word(
        &mut self,
        controller: &mut Controller,
        member: &Member,
        pulse: &mut Pulse,
        bell: &Doorbell,
    ) {
        let has_spoken = |learner: &mut Learner| {
            let _ = learner.hear();
            learner.newest.header.sequence > 0
        };
        match &self.learning {
            Some(learner) if !learner.is_silent && learner.newest.header.sequence == 0 => {
                self.wait(controller, (member, pulse, bell), has_spoken);
            }
            Some(_) | None => {}
        }
    }

    /// In lockstep with a learner, at the end of a block: waits until it has
    /// considered the last step, and until the loader has decided about what it
    /// published. So adoption happens at the same tick in every run.
    pub fn await_learner(
        &mut self,
        controller: &mut Controller,
        member: &Member,
        pulse: &mut Pulse,
        bell: &Doorbell,
    ) {
        let Some(learner) = &mut self.learning else {
            return;
        };
        // A successor that came before has nothing to say of this wait.
        let _ = learner.hear();
        let tick = controller.step().header.tick;
        let is_end = learner.count(tick);
        if !is_end || learner.is_silent {
            return;
        }
        let mut is_successor = false;
        let has_considered = |learner: &mut Learner| {
            // It never saw the step that is waited for: it would wait for ever.
            is_successor |= learner.hear() == Heard::Successor;
            is_successor || learner.has_considered(tick)
        };
        self.wait(controller, (member, pulse, bell), has_considered);
    }

    /// Waits for that of the learner, and for the loader's decision about what it
    /// published; adopts it.
    #[allow(clippy::disallowed_methods)] // the process entry point reads the clock
    fn wait(
        &mut self,
        controller: &mut Controller,
        (member, pulse, bell): (&Member, &mut Pulse, &Doorbell),
        mut is_done: impl FnMut(&mut Learner) -> bool,
    ) {
        let Some(learner) = &mut self.learning else {
            return;
        };
        let until = monotonic().after_ns(learner.wait_ns);
        while !member.is_stopping() {
            if is_done(learner) && learner.newest.version <= self.loader.exchange().decided() {
                break;
            }
            let now = monotonic();
            if now >= until {
                learner.is_silent = true;
                break;
            }
            pulse.beat(now);
            bell.wait(NAP.min(Duration::from_nanos(until.since_ns(now))));
        }
        self.take(controller);
    }
}

/// Who was heard.
#[derive(PartialEq, Eq)]
enum Heard {
    /// Nobody new.
    Same,
    /// A learner that was started in place of the one before.
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
            // Its first word is said before it considers any step.
            (None, 1) => self.newest.steps + self.own_steps,
            (None, _) => {
                let ahead = tick.saturating_sub(header.tick);
                self.newest.steps + ahead.min(self.own_steps)
            }
        };
        self.steps = Some(steps);
        steps.is_multiple_of(self.block_steps)
    }

    /// The learner has considered the step of this tick; its first word is of none.
    fn has_considered(&self, tick: u64) -> bool {
        self.newest.header.sequence > 1 && self.newest.header.tick >= tick
    }

    fn hear(&mut self) -> Heard {
        self.ports.update_connections();
        let Some(learning) = self.ports.learning.newest(Message::check) else {
            return Heard::Same;
        };
        let before = std::mem::replace(&mut self.newest, learning)
            .header
            .producer;
        self.is_silent = false;
        match before != 0 && before != learning.header.producer {
            true => Heard::Successor,
            false => Heard::Same,
        }
    }
}

/// Starts the loader, before the process claims real-time rights.
#[allow(clippy::disallowed_methods)] // the process entry point reads the clock
pub fn start(member: &Member) -> Result<Loader, SetUpError> {
    let clock: fn() -> Instant = monotonic;
    Loader::start(&member.config, clock)
        .map_err(|error| SetUpError::Own(format!("cannot start the loader's thread: {error}")))
}
