//! The events of a recorded episode: what a new policy has to stand.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use shm_config::message::{Outcome, Step};

use crate::fork::course::Course;
use crate::fork::drive::contacts;
use crate::replay::rebuild::Rebuilt;

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// The safety check vetoed the driver in charge.
    Veto,
    /// A person took over.
    Takeover,
    /// The car touched a vehicle or an object.
    Contact,
    /// A command was decided after its deadline.
    Late,
    /// The car left the road.
    OutOfRoad,
}

impl Kind {
    /// In words.
    pub fn word(self) -> &'static str {
        match self {
            Kind::Veto => "veto",
            Kind::Takeover => "takeover",
            Kind::Contact => "contact",
            Kind::Late => "late tick",
            Kind::OutOfRoad => "left the road",
        }
    }

    /// The events of a tick of the controller.
    fn of(step: &Step) -> impl Iterator<Item = Kind> {
        [
            step.is_vetoed().then_some(Kind::Veto),
            step.is_taken_over().then_some(Kind::Takeover),
            step.is_late().then_some(Kind::Late),
        ]
        .into_iter()
        .flatten()
    }
}

/// What became of the car within the time that is looked at; a worse one is larger.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum End {
    /// It arrived.
    Arrives,
    /// It still drove.
    TimesOut,
    /// It touched a vehicle or an object.
    Touches,
    /// It left the road.
    LeavesTheRoad,
}

impl End {
    /// Of an outcome, and of the contacts on the way to it.
    pub fn of(outcome: Outcome, contacts: u64) -> End {
        match outcome {
            Outcome::OutOfRoad => End::LeavesTheRoad,
            _ if contacts > 0 => End::Touches,
            Outcome::Arrived => End::Arrives,
            Outcome::Driving | Outcome::MaxStep | Outcome::Stopped => End::TimesOut,
        }
    }

    /// In words.
    pub fn word(self) -> &'static str {
        match self {
            End::Arrives => "arrives",
            End::TimesOut => "drives on",
            End::Touches => "touches",
            End::LeavesTheRoad => "leaves the road",
        }
    }
}

/// An event, by the index of the observation that it is of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// What happened.
    pub kind: Kind,
    /// The observation.
    pub index: usize,
}

/// Time up to which two events of a kind are one, ns.
const APART_NS: u64 = 1_000_000_000;

/// What the observations of an episode show beside its steps.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    /// Ticks with contact up to each observation.
    pub contacts: Vec<u64>,
}

impl Trace {
    /// Adds the next observation's.
    pub fn push(&mut self, rebuilt: &Rebuilt) {
        self.contacts.push(contacts(rebuilt));
    }
}

/// The events of the episode whose observations are `first..end`, the first of each second
/// of a kind.
pub fn events(course: &Course, (first, end): (usize, usize), trace: &Trace) -> Vec<Event> {
    let all = &course.messages.observations.all;
    let mut found: Vec<Event> = Vec::new();
    // Where an event of a kind was last seen to go on.
    let mut until_ns: BTreeMap<Kind, u64> = BTreeMap::new();
    let mut add = |kind: Kind, index: usize| {
        let now_ns = all[index].header.taken_ns;
        let last_ns = until_ns.insert(kind, now_ns);
        if last_ns.is_none_or(|last_ns| now_ns.saturating_sub(last_ns) > APART_NS) {
            found.push(Event { kind, index });
        }
    };
    let of_episode = all[first].header.episode;
    // A restarted world begins the episode again, with the same number.
    let end_ns = all.get(end).map_or(u64::MAX, |next| next.released_ns);
    for step in &course.messages.steps.all {
        let planned_ns = step.timings.planned_ns;
        if step.header.episode != of_episode || planned_ns >= end_ns {
            continue;
        }
        let after = all[first..end].partition_point(|seen| seen.released_ns <= planned_ns);
        let Some(index) = after.checked_sub(1).map(|index| first + index) else {
            continue;
        };
        Kind::of(step).for_each(|kind| add(kind, index));
    }
    for (offset, pair) in trace.contacts.windows(2).enumerate() {
        if pair[1] > pair[0] {
            add(Kind::Contact, first + offset + 1);
        }
    }
    let header = &all[first].header;
    let left = course.messages.episodes.all.iter().find(|episode| {
        (episode.header.producer, episode.header.episode) == (header.producer, header.episode)
    });
    if left.is_some_and(|episode| episode.outcome() == Outcome::OutOfRoad) {
        add(Kind::OutOfRoad, end - 1);
    }
    found.sort_by_key(|event| event.index);
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leaving_the_road_is_worse_than_a_contact_and_that_than_standing_still() {
        let ends = [
            (Outcome::Arrived, 0, End::Arrives),
            (Outcome::Driving, 0, End::TimesOut),
            (Outcome::MaxStep, 0, End::TimesOut),
            (Outcome::Stopped, 0, End::TimesOut),
            (Outcome::Arrived, 1, End::Touches),
            (Outcome::Driving, 2, End::Touches),
            (Outcome::OutOfRoad, 0, End::LeavesTheRoad),
            (Outcome::OutOfRoad, 3, End::LeavesTheRoad),
        ];
        for (outcome, contacts, end) in ends {
            assert_eq!(End::of(outcome, contacts), end, "{outcome:?}, {contacts}");
        }
        assert!(ends.is_sorted_by_key(|(_, _, end)| end));
    }
}
