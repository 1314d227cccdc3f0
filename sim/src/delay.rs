//! The time from a command to its effect on the ego's wheels, engine and brakes.

use std::collections::VecDeque;

use vehicle::{Action, Vehicle};

use crate::dynamics::SUBSTEP_S;

/// The actions that are on their way, oldest first; one for each sub-step of the delay.
#[derive(Clone, Debug, Default)]
pub(crate) struct Delay {
    actions: VecDeque<Action>,
}

impl Delay {
    /// The delay of a car, rounded to sub-steps.
    pub fn of(vehicle: &Vehicle) -> Delay {
        let substeps = (vehicle.delay_s() / SUBSTEP_S).round() as usize;
        // One more: the new action comes before the oldest one goes.
        let mut actions = VecDeque::with_capacity(substeps + 1);
        actions.resize(substeps, Action::default());
        Delay { actions }
    }

    /// An episode begins: nothing is on its way.
    pub fn forget(&mut self) {
        self.actions
            .iter_mut()
            .for_each(|action| *action = Action::default());
    }

    /// Whether every action takes effect at once.
    pub fn is_none(&self) -> bool {
        self.actions.is_empty()
    }

    /// The action that takes effect in the sub-step in which this one is given.
    pub fn pass(&mut self, action: Action) -> Action {
        self.actions.push_back(action);
        self.actions.pop_front().unwrap_or(action)
    }
}
