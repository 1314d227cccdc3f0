//! The events on which a flight recording is written.

use shm_config::layout::Layout;
use shm_config::message::{Health, LATE_APART_NS, Progress, Step};
use shm_config::services::{FAULT, PROGRESS, STEP};

use crate::schema::ENCAPSULATION;

/// Looks for events. One that lasts is told once, when it begins.
#[derive(Debug, Default)]
pub(super) struct Triggers {
    is_vetoed: bool,
    is_taken_over: bool,
    /// When the last late tick was.
    late_ns: Option<u64>,
    /// The episode, and its ticks in contact.
    contacts: (u32, u64),
    /// The process ids by service; a new one shows a restart.
    producers: Vec<(String, u32)>,
}

impl Triggers {
    /// The event that begins with this message; `None` for none.
    pub(super) fn look(&mut self, service: &str, cdr: &[u8]) -> Option<&'static str> {
        let memory = cdr.get(ENCAPSULATION.len()..)?;
        match service {
            service if service == STEP.name => self.step(&Step::from_bytes(memory)?),
            service if service == PROGRESS.name => self.progress(&Progress::from_bytes(memory)?),
            service if service == FAULT.name => Some("fault"),
            service if service.starts_with("health/") => {
                self.health(service, &Health::from_bytes(memory)?)
            }
            _ => None,
        }
    }

    fn step(&mut self, step: &Step) -> Option<&'static str> {
        let was_vetoed = std::mem::replace(&mut self.is_vetoed, step.is_vetoed());
        let was_taken_over = std::mem::replace(&mut self.is_taken_over, step.is_taken_over());
        if step.is_late() {
            let taken_ns = step.header.taken_ns;
            let last_ns = self.late_ns.replace(taken_ns);
            let is_apart = |last_ns| taken_ns.saturating_sub(last_ns) > LATE_APART_NS;
            return last_ns.is_none_or(is_apart).then_some("late");
        }
        if step.is_taken_over() && !was_taken_over {
            return Some("takeover");
        }
        (step.is_vetoed() && !was_vetoed).then_some("veto")
    }

    fn progress(&mut self, progress: &Progress) -> Option<&'static str> {
        let episode = progress.header.episode;
        let count = progress.contacts();
        let before = std::mem::replace(&mut self.contacts, (episode, count));
        let is_more = match before.0 == episode {
            true => before.1 == 0 && count > 0,
            false => count > 0,
        };
        is_more.then_some("contact")
    }

    fn health(&mut self, service: &str, health: &Health) -> Option<&'static str> {
        let producer = health.header.producer;
        let known = self.producers.iter_mut().find(|(name, _)| name == service);
        let Some((_, known)) = known else {
            self.producers.push((service.into(), producer));
            return None;
        };
        (std::mem::replace(known, producer) != producer).then_some("restart")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shm_config::message::{Lateness, Reason};

    fn cdr(message: &impl Layout) -> Vec<u8> {
        [&ENCAPSULATION[..], message.as_bytes()].concat()
    }

    #[test]
    fn each_event_is_told_once_when_it_begins() {
        let mut triggers = Triggers::default();
        let mut step = Step::default();
        let mut look = |step: &Step| triggers.look("step", &cdr(step));
        assert_eq!(look(&step), None);
        step.command.reason = Reason::Vetoed.code();
        assert_eq!(look(&step), Some("veto"));
        assert_eq!(look(&step), None);
        step.command.reason = Reason::Takeover.code();
        step.takeover_used = 1;
        assert_eq!(look(&step), Some("takeover"));
        assert_eq!(look(&step), None);
        step.lateness = Lateness::Braked.code();
        assert_eq!(look(&step), Some("late"));
        // Under load every tick may be late.
        for tenths in 1..40 {
            step.header.taken_ns = tenths * LATE_APART_NS / 10;
            assert_eq!(look(&step), None);
        }
        step.header.taken_ns += LATE_APART_NS + 1;
        assert_eq!(look(&step), Some("late"));
        let mut progress = Progress::default();
        let mut look = |progress: &Progress| triggers.look("progress", &cdr(progress));
        assert_eq!(look(&progress), None);
        progress.object_contacts = 1;
        assert_eq!(look(&progress), Some("contact"));
        progress.object_contacts = 2;
        assert_eq!(look(&progress), None);
        progress.header.episode = 1;
        progress.vehicle_contacts = u64::MAX;
        assert_eq!(look(&progress), Some("contact"));
        let mut health = Health::default();
        health.header.producer = 7;
        assert_eq!(triggers.look("health/world", &cdr(&health)), None);
        assert_eq!(triggers.look("health/planner", &cdr(&health)), None);
        health.header.producer = 8;
        assert_eq!(
            triggers.look("health/world", &cdr(&health)),
            Some("restart")
        );
    }
}
