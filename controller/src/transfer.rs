use shm_config::config::{Config, Controller as Gains, GateMode};
use shm_config::message::{Driver, Reason};
use vehicle::Action;

use crate::Choice;

/// Bumpless transfer: when the wheel changes hands, the command moves from what
/// it was to what the new driver wants at a limited rate, not in one jump.
///
/// Danger is no time for it: a veto, a person's grip and the brake act at once,
/// and so does a driver whose eased command would be unsafe.
#[derive(Debug, Clone, Copy)]
pub struct Transfer {
    steer_step: f64,
    pedal_step: f64,
    last: Option<Last>,
    is_easing: bool,
}

#[derive(Debug, Clone, Copy)]
struct Last {
    driver: Driver,
    action: Action,
    episode: u32,
}

impl Transfer {
    /// As configured. The paper's hand-overs jump (Sec. 4.2), and so does
    /// `--gate paper`.
    pub fn of(config: &Config) -> Self {
        let mut gains = config.controller;
        if config.gate.mode == GateMode::Paper {
            (gains.handover_steer_per_s, gains.handover_pedal_per_s) = (0.0, 0.0);
        }
        Self::new(&gains, config.run.period_ns() as f64 / 1e9)
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
            last: None,
            is_easing: false,
        }
    }

    /// The action to command. `is_safe` is asked of an eased action only.
    pub fn ease(
        &mut self,
        choice: &Choice,
        episode: u32,
        is_safe: impl FnOnce(Action) -> bool,
    ) -> Action {
        let before = self.last.filter(|last| last.episode == episode);
        let action = match before {
            None => {
                self.is_easing = false;
                choice.action
            }
            Some(before) => self.ease_from(&before, choice, is_safe),
        };
        self.last = Some(Last {
            driver: choice.driver,
            action,
            episode,
        });
        action
    }

    fn ease_from(
        &mut self,
        before: &Last,
        choice: &Choice,
        is_safe: impl FnOnce(Action) -> bool,
    ) -> Action {
        let is_urgent = matches!(choice.reason, Reason::Vetoed | Reason::Takeover);
        if choice.driver == Driver::Brake || before.driver == Driver::Brake || is_urgent {
            self.is_easing = false;
        } else if choice.driver != before.driver {
            self.is_easing = true;
        }
        if !self.is_easing {
            return choice.action;
        }
        let wanted = choice.action;
        let toward = |from: f64, to: f64, step: f64| from + (to - from).clamp(-step, step);
        let eased = Action {
            steer: toward(before.action.steer, wanted.steer, self.steer_step),
            pedal: toward(before.action.pedal, wanted.pedal, self.pedal_step),
        };
        // Floats: what is within a step is there.
        let is_there = (wanted.steer - before.action.steer).abs() <= self.steer_step
            && (wanted.pedal - before.action.pedal).abs() <= self.pedal_step;
        if is_there || !is_safe(eased) {
            self.is_easing = false;
            return wanted;
        }
        eased
    }
}
