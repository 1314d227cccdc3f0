//! What the page of all runs shows of one run.

use std::sync::Arc;

use serde::{Serialize, Serializer};
use supervisor::show::view::{EpisodeView, View};

use super::machine::Machine;
use super::state::State;
use crate::live::events::{Event, Kind};

/// Everything that the page shows of one run.
#[derive(Debug, Clone, Serialize)]
pub struct Card {
    /// Its name.
    pub name: String,
    /// Its state.
    pub state: State,
    /// Why it has this state, if there is more to say.
    pub note: String,
    /// The machine it comes from; `None` for this one.
    pub machine: Option<Machine>,
    /// Age of the newest step, s; of an ended run, the time since its end was seen. `None`
    /// before the first step.
    pub age_s: Option<f64>,
    /// What its processes tell.
    #[serde(flatten)]
    pub figures: Figures,
    /// Who drove in the last minute: a [`super::minute::Minute`].
    pub band: Vec<u8>,
    /// The newest scene, JSON within JSON; empty before the first.
    #[serde(serialize_with = "text")]
    pub scene: Arc<str>,
    /// The newest sample of the run's course, likewise.
    #[serde(serialize_with = "text")]
    pub sample: Arc<str>,
}

impl Card {
    /// The order of cards: the most urgent first, then by name.
    pub fn order(&self) -> (State, &str) {
        (self.state, &self.name)
    }
}

fn text<S: Serializer>(text: &Arc<str>, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(text)
}

/// The figures of a run.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Figures {
    /// Real time or lockstep.
    pub clock: &'static str,
    /// Ticks of the controller per second.
    pub rate_hz: f64,
    /// Length and width of the car, m.
    pub car_m: [f64; 2],
    /// The current episode.
    pub episode: Option<EpisodeView>,
    /// Driver and reason.
    pub driver: Option<(&'static str, &'static str)>,
    /// Outcomes that were read, with their counts.
    pub outcomes: Vec<(&'static str, usize)>,
    /// Late ticks of all processes.
    pub late: u64,
    /// Skipped ticks of all processes.
    pub skipped: u64,
    /// Processes that were restarted, with their counts.
    pub restarts: Vec<(&'static str, u32)>,
    /// Events since the reading began.
    #[serde(flatten)]
    pub counts: Counts,
    /// Time since the reading began, s.
    pub read_s: f64,
}

impl Figures {
    /// Takes in what a run's processes tell.
    pub fn take(&mut self, view: View) {
        let sum = |of: fn(&supervisor::show::view::ProcessView) -> u64| -> u64 {
            view.processes.iter().map(of).sum()
        };
        self.late = sum(|process| process.late);
        self.skipped = sum(|process| process.skipped);
        let restarted = view.processes.iter().filter(|process| process.restarts > 0);
        self.restarts = restarted
            .map(|process| (process.process, process.restarts))
            .collect();
        self.clock = view.clock;
        self.rate_hz = view.rate_hz;
        self.episode = view.episode;
        self.driver = view.driver;
        let occurred = view.outcomes.into_iter();
        self.outcomes = occurred.filter(|(_, count)| *count > 0).collect();
    }
}

/// Events by kind.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Vetoes.
    pub vetoes: u64,
    /// Takeovers.
    pub takeovers: u64,
    /// Contacts.
    pub contacts: u64,
    /// Faults and restarts.
    pub faults: u64,
}

impl Counts {
    /// Adds an event; whether it is worth a mark on the band.
    pub fn add(&mut self, event: &Event) -> bool {
        let count = match event.kind {
            Kind::Veto => &mut self.vetoes,
            Kind::Takeover => &mut self.takeovers,
            Kind::Contact => &mut self.contacts,
            Kind::Fault => &mut self.faults,
            Kind::Late | Kind::Swap | Kind::Episode => return false,
        };
        *count += 1;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_are_counted_by_kind_and_the_common_ones_leave_no_mark() {
        let mut counts = Counts::default();
        let mut add = |kind| {
            counts.add(&Event {
                tick: 1,
                kind,
                text: String::new(),
            })
        };
        let marked = [
            Kind::Veto,
            Kind::Veto,
            Kind::Takeover,
            Kind::Contact,
            Kind::Fault,
        ];
        assert!(marked.map(&mut add).iter().all(|is_marked| *is_marked));
        let common = [Kind::Late, Kind::Swap, Kind::Episode];
        assert!(common.map(&mut add).iter().all(|is_marked| !is_marked));
        let expected = Counts {
            vetoes: 2,
            takeovers: 1,
            contacts: 1,
            faults: 1,
        };
        assert_eq!(counts, expected);
    }
}
