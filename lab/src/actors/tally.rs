//! What the actors of a training did.

use std::collections::BTreeMap;

use comfy_table::Table;
use serde::{Deserialize, Serialize};

use super::envelope::Rejection;
use crate::report::table;

/// One actor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ActorTally {
    /// Episodes of it that were the first answer.
    pub episodes: u64,
    /// Their transitions.
    pub transitions: u64,
    /// How often it or its connection ended before the training did.
    pub deaths: u64,
    /// Its open connections; none once the training has ended.
    #[serde(default)]
    pub connected: u32,
}

/// All actors.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ActorsTally {
    /// By name.
    pub actors: BTreeMap<String, ActorTally>,
    /// Answers about an episode that was known already.
    pub doubles: u64,
    /// Episodes that were given to an actor again.
    pub given_again: u64,
    /// Transitions beyond the end of their block, which are not learnt.
    pub surplus: u64,
    /// Refused frames by reason; each ended its connection.
    pub refused: BTreeMap<String, u64>,
}

impl ActorsTally {
    /// The actor of a name.
    pub fn of(&mut self, name: &str) -> &mut ActorTally {
        self.actors.entry(name.to_string()).or_default()
    }

    /// Counts a refused frame.
    pub fn refuse(&mut self, why: Rejection) {
        *self.refused.entry(why.word().into()).or_default() += 1;
    }

    /// Adds those of an earlier part of the same training.
    pub fn add(&mut self, earlier: &ActorsTally) {
        for (name, before) in &earlier.actors {
            let actor = self.of(name);
            actor.episodes += before.episodes;
            actor.transitions += before.transitions;
            actor.deaths += before.deaths;
        }
        self.doubles += earlier.doubles;
        self.given_again += earlier.given_again;
        self.surplus += earlier.surplus;
        for (why, count) in &earlier.refused {
            *self.refused.entry(why.clone()).or_default() += count;
        }
    }

    /// A row for each actor.
    pub fn table(&self) -> Table {
        let mut rows = table(&["actor", "episodes", "transitions", "deaths"]);
        for (name, actor) in &self.actors {
            rows.add_row([
                name.clone(),
                actor.episodes.to_string(),
                actor.transitions.to_string(),
                actor.deaths.to_string(),
            ]);
        }
        rows
    }

    /// The counts of all, as one line.
    pub fn line(&self) -> String {
        let refused = match self.refused.is_empty() {
            true => "none".into(),
            false => {
                let each = self.refused.iter();
                let each: Vec<_> = each.map(|(why, count)| format!("{count} {why}")).collect();
                each.join(", ")
            }
        };
        format!(
            "given to an actor again: {}; doubles ignored: {}; surplus transitions: {}; refused: \
             {refused}",
            self.given_again, self.doubles, self.surplus
        )
    }
}
