use shm_config::message::{Driver, Reason, TransferState};
use shm_config::settings::{Controller as Gains, GateMode};
use vehicle::Action;

use crate::{ArbiterConfig, Choice};

/// Bumpless transfer: at a hand-over the command moves from the last driver's to the
/// new driver's at a limited rate, not in one jump.
///
/// A veto, a takeover and the brake act immediately, and so does a driver whose eased
/// command would be unsafe.
#[derive(Debug, Clone, Copy)]
pub struct Transfer {
    steer_step: f64,
    pedal_step: f64,
    /// The command of the last tick, and whether it is on its way to another.
    last: TransferState,
}

impl Transfer {
    /// With the configured rates, at one tick each period of the run.
    pub fn of(config: &ArbiterConfig) -> Self {
        let mut gains = config.gains;
        if config.mode == GateMode::Takeover {
            // The tick that is taken over and the tick after it each apply one driver's
            // own action: an eased one would be neither's, and teaches neither.
            (gains.handover_steer_per_s, gains.handover_pedal_per_s) = (0.0, 0.0);
        }
        Self::new(&gains, config.period_ns as f64 / 1e9)
    }

    /// With the configured rates, at one tick each `period_s`.
    pub fn new(gains: &Gains, period_s: f64) -> Self {
        // A hand-over without a limit is one in a single step.
        let step = |per_s: f64| match per_s > 0.0 {
            true => per_s * period_s,
            false => f64::INFINITY,
        };
        Self {
            steer_step: step(gains.handover_steer_per_s),
            pedal_step: step(gains.handover_pedal_per_s),
            last: TransferState::default(),
        }
    }

    /// What the next tick starts from.
    pub fn state(&self) -> TransferState {
        self.last
    }

    /// Restores this state.
    pub fn restore(&mut self, state: &TransferState) {
        self.last = *state;
    }

    /// The action to command. `is_safe` is asked of an eased action only.
    pub fn ease(
        &mut self,
        choice: &Choice,
        episode: u32,
        is_safe: impl FnOnce(Action) -> bool,
    ) -> Action {
        let before = self.last;
        let has_before = before.present == 1 && before.episode == episode;
        let (action, is_easing) = match has_before {
            true => self.ease_from(&before, choice, is_safe),
            false => (choice.action, false),
        };
        self.last = TransferState {
            steer: action.steer,
            pedal: action.pedal,
            driver: choice.driver.code(),
            episode,
            present: 1,
            is_easing: u32::from(is_easing),
        };
        action
    }

    /// The action to command, and whether it is still on its way.
    fn ease_from(
        &self,
        before: &TransferState,
        choice: &Choice,
        is_safe: impl FnOnce(Action) -> bool,
    ) -> (Action, bool) {
        let wanted = choice.action;
        let is_urgent = matches!(choice.reason, Reason::Vetoed | Reason::Takeover);
        let brakes = [choice.driver.code(), before.driver].contains(&Driver::Brake.code());
        let changes = choice.driver.code() != before.driver;
        if brakes || is_urgent || !(changes || before.is_easing == 1) {
            return (wanted, false);
        }
        let toward = |from: f64, to: f64, step: f64| from + (to - from).clamp(-step, step);
        let eased = Action {
            steer: toward(before.steer, wanted.steer, self.steer_step),
            pedal: toward(before.pedal, wanted.pedal, self.pedal_step),
        };
        // A difference within one step ends the hand-over: floats rarely become equal.
        let is_there = (wanted.steer - before.steer).abs() <= self.steer_step
            && (wanted.pedal - before.pedal).abs() <= self.pedal_step;
        match is_there || !is_safe(eased) {
            true => (wanted, false),
            false => (eased, true),
        }
    }
}
