//! What a run's messages tell that is worth a jump: vetoes, takeovers, contacts, late
//! ticks, faults, swaps, episodes.

use serde::Serialize;
use shm_config::message::{
    Assessment, Episode, Health, LATE_APART_NS, Lateness, Outcome, PolicyState, PolicyStatus,
    Progress, Reason, Step,
};
use shm_config::services::Process;
use shm_config::text::printable;

/// Longest text of an event, characters.
const TEXT_MAX: usize = 160;

/// The kind of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// The safety check vetoed the driver in charge.
    Veto,
    /// A person took over.
    Takeover,
    /// The car touched something.
    Contact,
    /// A tick was late, or was skipped.
    Late,
    /// The brake drove for a fault, or a process was restarted.
    Fault,
    /// Other weights propose.
    Swap,
    /// An episode ended.
    Episode,
}

/// Something that happened at a tick.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Event {
    /// The tick.
    pub tick: u64,
    /// Its kind.
    pub kind: Kind,
    /// One line, fit to be shown.
    pub text: String,
}

impl Event {
    fn new(tick: u64, kind: Kind, text: &str) -> Self {
        let text = printable(text).chars().take(TEXT_MAX).collect();
        Self { tick, kind, text }
    }
}

/// Finds events in a run's messages, in their order.
#[derive(Debug, Default)]
pub struct Detector {
    /// Tick and process of each restart.
    pub restarts: Vec<(u64, Process)>,
    found: Vec<Event>,
    last: Option<Before>,
    late_ns: Option<u64>,
    contacts: Contacts,
    producers: [u32; shm_config::message::PROCESSES],
    offer: (u64, u32),
}

/// The contacts of the last progress.
#[derive(Debug, Default)]
struct Contacts {
    episode: u32,
    ticks: u64,
    is_touching: bool,
}

/// What matters of the step before.
#[derive(Debug, Clone, Copy)]
struct Before {
    reason: Option<Reason>,
    is_taken_over: bool,
    skipped: u64,
    controller: u32,
    weights: u64,
}

impl Detector {
    /// The events found since the last call.
    pub fn take(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.found)
    }

    fn add(&mut self, tick: u64, kind: Kind, text: &str) {
        self.found.push(Event::new(tick, kind, text));
    }

    /// Reads a step.
    pub fn step(&mut self, step: &Step) {
        let now = Before {
            reason: step.reason(),
            is_taken_over: step.is_taken_over(),
            skipped: step.skipped,
            controller: step.header.producer,
            weights: step.weights_version,
        };
        let before = self.last.replace(now);
        let tick = step.header.tick;
        if before.is_none_or(|before| before.reason != now.reason) {
            self.reason(step, now.reason);
        }
        let was_taken = before.is_some_and(|before| before.is_taken_over);
        if now.is_taken_over && !was_taken {
            self.add(tick, Kind::Takeover, "a person takes over");
        }
        if let Some(before) = before {
            if before.weights != now.weights {
                let text = format!("weights {} to {}", before.weights, now.weights);
                self.add(tick, Kind::Swap, &text);
            }
            let skipped = now.skipped.saturating_sub(before.skipped);
            if before.controller == now.controller && skipped > 0 {
                self.late(step, &format!("controller skipped {skipped} ticks"));
            }
        }
        match Lateness::from_code(step.lateness) {
            Some(Lateness::OnTime) => {}
            lateness => {
                let word = lateness.map_or("unknown", Lateness::word);
                let decided_ns = step
                    .timings
                    .decided_ns
                    .saturating_sub(step.timings.scheduled_ns);
                let text = format!(
                    "command decided {:.3} ms after its instant: {word}",
                    decided_ns as f64 / 1e6
                );
                self.late(step, &text);
            }
        }
    }

    /// A step with another reason than the one before.
    fn reason(&mut self, step: &Step, reason: Option<Reason>) {
        let tick = step.header.tick;
        match reason {
            Some(Reason::Vetoed | Reason::Unsafe) => {
                self.add(tick, Kind::Veto, &veto_text(step));
            }
            Some(
                Reason::Blind
                | Reason::Blocked
                | Reason::Unplanned
                | Reason::Contested
                | Reason::Faulty
                | Reason::Late,
            )
            | None => {
                let word = reason.map_or("unknown", Reason::word);
                let text = format!("{} drives: {word}", step.driver());
                self.add(tick, Kind::Fault, &text);
            }
            Some(
                Reason::Configured
                | Reason::Advised
                | Reason::Unadvised
                | Reason::Expired
                | Reason::Unloaded
                | Reason::Stopping
                | Reason::Takeover
                | Reason::Shadow,
            ) => {}
        }
    }

    fn late(&mut self, step: &Step, text: &str) {
        let taken_ns = step.header.taken_ns;
        let is_apart = |last| taken_ns.saturating_sub(last) > LATE_APART_NS;
        if self.late_ns.is_none_or(is_apart) {
            self.add(step.header.tick, Kind::Late, text);
        }
        self.late_ns = Some(taken_ns);
    }

    /// Reads the world's progress.
    pub fn progress(&mut self, progress: &Progress) {
        let (header, last) = (&progress.header, &self.contacts);
        let ticks = progress.contacts();
        let before = match last.episode == header.episode {
            true => last.ticks,
            false => 0,
        };
        // The count is of ticks in contact: while it grows, the contact lasts.
        let is_touching = ticks > before;
        let is_new = is_touching && (before == 0 || !last.is_touching);
        self.contacts = Contacts {
            episode: header.episode,
            ticks,
            is_touching,
        };
        if is_new {
            let what = match progress.vehicle_contacts > 0 {
                true => "a vehicle",
                false => "an object",
            };
            self.add(
                header.tick,
                Kind::Contact,
                &format!("the car touches {what}"),
            );
        }
    }

    /// Reads an episode's result.
    pub fn episode(&mut self, episode: &Episode) {
        let text = format!(
            "episode {} (seed {}): {}, {:.0} % of the route, {} ticks in contact",
            episode.header.episode.saturating_add(1),
            episode.seed,
            episode.outcome().word(),
            100.0 * episode.completion,
            episode.contacts()
        );
        let kind = match episode.outcome() {
            Outcome::OutOfRoad => Kind::Fault,
            Outcome::Arrived | Outcome::MaxStep | Outcome::Stopped | Outcome::Driving => {
                Kind::Episode
            }
        };
        self.add(episode.header.tick, kind, &text);
    }

    /// Reads a process's health: another producer is a restart.
    pub fn health(&mut self, process: Process, health: &Health) {
        let (pid, tick) = (health.header.producer, health.header.tick);
        let known = &mut self.producers[process.code() as usize];
        let before = std::mem::replace(known, pid);
        if before != 0 && before != pid {
            let text = format!("{process} was restarted: process {before} became {pid}");
            self.add(tick, Kind::Fault, &text);
            self.restarts.push((tick, process));
        }
    }

    /// Reads the status of offered weights.
    pub fn policy(&mut self, status: &PolicyStatus) {
        let offer = (status.offered_version, status.state);
        if std::mem::replace(&mut self.offer, offer) == offer {
            return;
        }
        if let state @ (PolicyState::Refused | PolicyState::RolledBack) = status.state() {
            let (version, word) = (status.offered_version, state.word());
            let text = format!("weights {version} {word}: {}", status.refusal());
            self.add(status.header.tick, Kind::Fault, &text);
        }
    }
}

/// Who was vetoed, and for what.
fn veto_text(step: &Step) -> String {
    let told = |name: &str, assessment: &Assessment| match assessment.is_vetoed() {
        true => Some(format!(
            "{name} {} in {:.1} s",
            assessment.verdict().word(),
            assessment.safe_s
        )),
        false => None,
    };
    let vetoed: Vec<_> = [
        told("policy", &step.policy_assessment),
        told("expert", &step.expert_assessment),
    ]
    .into_iter()
    .flatten()
    .collect();
    format!("veto: {}; {} drives", vetoed.join(", "), step.driver())
}

#[cfg(test)]
mod tests {
    use super::*;
    use shm_config::message::Driver;

    fn step(tick: u64, driver: Driver, reason: Reason) -> Step {
        let mut step = Step::default();
        (step.header.tick, step.header.taken_ns) = (tick, tick * 10_000_000);
        (step.command.driver, step.command.reason) = (driver.code(), reason.code());
        step
    }

    fn kinds(detector: &mut Detector) -> Vec<(u64, Kind)> {
        let events = detector.take();
        events
            .iter()
            .map(|event| (event.tick, event.kind))
            .collect()
    }

    #[test]
    fn a_veto_is_one_event_however_long_it_lasts() {
        let mut detector = Detector::default();
        detector.step(&step(1, Driver::Policy, Reason::Advised));
        (2..9).for_each(|tick| detector.step(&step(tick, Driver::Expert, Reason::Vetoed)));
        detector.step(&step(9, Driver::Policy, Reason::Advised));
        detector.step(&step(10, Driver::Expert, Reason::Vetoed));
        assert_eq!(kinds(&mut detector), [(2, Kind::Veto), (10, Kind::Veto)]);
    }

    #[test]
    fn takeovers_swaps_late_ticks_and_restarts_are_events() {
        let mut detector = Detector::default();
        detector.step(&step(1, Driver::Policy, Reason::Advised));
        let mut taken = step(2, Driver::Expert, Reason::Takeover);
        (taken.takeover_used, taken.weights_version) = (1, 4);
        detector.step(&taken);
        taken.header.tick = 3;
        taken.lateness = Lateness::Counted.code();
        detector.step(&taken);
        taken.header.tick = 4;
        detector.step(&taken);
        let expected = [(2, Kind::Takeover), (2, Kind::Swap), (3, Kind::Late)];
        assert_eq!(kinds(&mut detector), expected);
        let mut health = Health::default();
        for pid in [7, 7, 8] {
            health.header.producer = pid;
            detector.health(Process::Planner, &health);
        }
        assert_eq!(kinds(&mut detector), [(0, Kind::Fault)]);
    }

    #[test]
    fn a_contact_is_told_once_while_it_lasts_and_hostile_text_is_escaped() {
        let mut detector = Detector::default();
        let mut progress = Progress::default();
        for (episode, contacts) in [(0, 0), (0, 1), (0, 2), (0, 2), (0, 3), (1, 0), (1, 3)] {
            progress.header.episode = episode;
            progress.vehicle_contacts = contacts;
            detector.progress(&progress);
        }
        assert_eq!(kinds(&mut detector), [(0, Kind::Contact); 3]);
        let mut status = PolicyStatus {
            state: PolicyState::Refused.code(),
            offered_version: 3,
            ..PolicyStatus::default()
        };
        status.set_refusal("\u{1b}[31m\u{202e}<script>");
        detector.policy(&status);
        detector.policy(&status);
        let events = detector.take();
        assert_eq!(events.len(), 1);
        assert!(events[0].text.contains("\\u{1b}"), "{events:?}");
        assert!(!events[0].text.contains('\u{202e}'));
    }
}
