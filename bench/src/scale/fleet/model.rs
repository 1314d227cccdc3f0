//! Parts of a fleet with their loads, and in which order they break.

use serde::Serialize;

use super::costs::{
    ANSWER_S, ANSWERS_AT_ONCE, BLOCK, BYTE_S, Flow, INFERENCE_S, MESSAGE_S, POLICY_BYTES,
    POLICY_PERIOD_S, QUESTIONS_HZ, RATE_HZ, SERVER_BYTES_S, SERVER_CORES, SERVER_MEMORY_BYTES,
    UPDATE_S, UPLINK_BYTES_S, WORLD_TICK_S, WORLDS, receiving_s, transition_bytes,
};

/// Most parts that are repaired one after the other: more than there are parts.
const REPAIRS_MAX: usize = 32;

/// A part that members of the fleet share, or that each has.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Part {
    /// Its name.
    pub name: &'static str,
    /// What one member asks of it, with the unit.
    pub demand: String,
    /// Share of its capacity that one member takes.
    pub load_per_member: f64,
    /// Whether each member has one of its own.
    pub is_own: bool,
    /// What is done when it breaks.
    pub remedy: Remedy,
}

/// What is done when a part breaks.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Remedy {
    /// As many of it as the fleet needs; a sentence says how the work is divided.
    More {
        /// How.
        how: &'static str,
    },
    /// Each member asks less of it, by this factor.
    Less {
        /// Remaining share of the demand.
        factor: f64,
        /// How.
        how: &'static str,
    },
}

impl Remedy {
    /// How, in words.
    pub fn how(&self) -> &'static str {
        match self {
            Remedy::More { how } | Remedy::Less { how, .. } => how,
        }
    }
}

impl Part {
    /// One that all members share.
    fn shared(name: &'static str, demand: String, load_per_member: f64, remedy: Remedy) -> Self {
        Self {
            name,
            demand,
            load_per_member,
            is_own: false,
            remedy,
        }
    }

    /// The share of its capacity that a fleet takes; above 1 it breaks.
    pub fn load(&self, members: u64) -> f64 {
        match self.is_own {
            true => self.load_per_member,
            false => self.load_per_member * members as f64,
        }
    }

    /// Members with which it is just full; `None` where their number does not matter.
    pub fn members_max(&self) -> Option<f64> {
        (!self.is_own).then(|| 1.0 / self.load_per_member)
    }
}

/// One part that broke, and what was done.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Break {
    /// The part.
    pub part: &'static str,
    /// Its load with the whole fleet.
    pub load: f64,
    /// Members with which it was just full; `None` where their number does not matter.
    pub members_max: Option<f64>,
    /// What was done.
    pub remedy: &'static str,
    /// Its load afterwards.
    pub load_after: f64,
    /// Number of them afterwards.
    pub count_after: u64,
}

/// Repairs the parts of a fleet, that with the largest load first, until none breaks.
pub fn repair(parts: &[Part], members: u64) -> Vec<Break> {
    let mut parts = parts.to_vec();
    let mut breaks = Vec::new();
    while breaks.len() < REPAIRS_MAX {
        let worst = parts
            .iter_mut()
            .max_by(|a, b| a.load(members).total_cmp(&b.load(members)));
        let Some(part) = worst.filter(|part| part.load(members) > 1.0) else {
            break;
        };
        let (load, members_max) = (part.load(members), part.members_max());
        let count_after = match part.remedy {
            Remedy::Less { factor, .. } => {
                part.load_per_member *= factor;
                1
            }
            Remedy::More { .. } => {
                let count = load.ceil();
                part.load_per_member /= count;
                count as u64
            }
        };
        breaks.push(Break {
            part: part.name,
            load,
            members_max,
            remedy: part.remedy.how(),
            load_after: part.load(members),
            count_after,
        });
        // A second failure of the same part needs more of it.
        part.remedy = Remedy::More {
            how: "more of them, each for a share of the fleet",
        };
    }
    breaks
}

/// Transitions of an actor in real time, 1/s.
pub fn transitions_per_s() -> f64 {
    WORLDS * RATE_HZ
}

/// Time of a core to receive a message of an actor, s.
pub fn block_s() -> f64 {
    MESSAGE_S + BLOCK * transition_bytes() * BYTE_S
}

/// The parts of actors with one learner.
pub fn of_actors() -> Vec<Part> {
    let rate = transitions_per_s();
    let bytes = transition_bytes();
    let part = Part::shared;
    vec![
        Part {
            is_own: true,
            ..part(
                "core of the actor",
                format!("{rate:.0} ticks and answers/s"),
                rate * (WORLD_TICK_S + INFERENCE_S),
                Remedy::More { how: "more cores" },
            )
        },
        part(
            "updates of the learner, one for each step",
            format!("{rate:.0} updates/s"),
            rate * UPDATE_S,
            Remedy::Less {
                factor: 0.0,
                how: "as many updates as the learner can make, at any number of steps",
            },
        ),
        part(
            "network to the learner",
            format!("{:.2} MB/s", rate * bytes * 1e-6),
            rate * bytes / SERVER_BYTES_S,
            Remedy::Less {
                factor: 0.25,
                how: "features in 16 bits, and not sent again as the next state",
            },
        ),
        part(
            "receiving of blocks",
            format!(
                "{:.1} messages/s of {:.0} kB",
                rate / BLOCK,
                BLOCK * bytes * 1e-3
            ),
            rate / BLOCK * block_s() / SERVER_CORES,
            Remedy::More {
                how: "receivers that keep a share of the replay each",
            },
        ),
        part(
            "memory for the order of a block",
            format!("{:.0} kB, two blocks", 2.0 * BLOCK * bytes * 1e-3),
            2.0 * BLOCK * bytes / SERVER_MEMORY_BYTES,
            Remedy::More {
                how: "receivers that keep a share of the replay each",
            },
        ),
        part(
            "new policies to the actors",
            format!("{:.0} kB every {POLICY_PERIOD_S:.0} s", POLICY_BYTES * 1e-3),
            POLICY_BYTES / POLICY_PERIOD_S / SERVER_BYTES_S,
            Remedy::More {
                how: "routers that pass a policy on",
            },
        ),
    ]
}

/// The parts of cars with one server.
pub fn of_cars(flows: &[Flow]) -> Vec<Part> {
    let sum = |of: fn(&Flow) -> f64| flows.iter().map(of).sum::<f64>();
    let bytes = sum(Flow::bytes_per_s);
    let messages = sum(|flow| flow.messages_per_s);
    let queue = sum(|flow| flow.queue_bytes);
    let timing = flows.iter().filter(|flow| flow.service == "timing/*");
    let timing: f64 = timing.map(Flow::bytes_per_s).sum();
    let seldom = Remedy::Less {
        // Histograms once a minute in place of twice a second.
        factor: 1.0 - timing / bytes * (1.0 - 1.0 / 120.0),
        how: "histograms (timing/*) once a minute in place of twice a second",
    };
    let part = Part::shared;
    vec![
        Part {
            is_own: true,
            ..part(
                "uplink of the car",
                format!("{:.2} MB/s", bytes * 1e-6),
                bytes / UPLINK_BYTES_S,
                seldom.clone(),
            )
        },
        part(
            "network of the server",
            format!("{:.2} MB/s", bytes * 1e-6),
            bytes / SERVER_BYTES_S,
            seldom,
        ),
        part(
            "receiving of messages",
            format!("{messages:.0} messages/s"),
            receiving_s(flows) / SERVER_CORES,
            Remedy::More {
                how: "servers, each for a share of the cars",
            },
        ),
        part(
            "memory of the queues",
            format!("{:.1} MB", queue * 1e-6),
            queue / SERVER_MEMORY_BYTES,
            Remedy::More {
                how: "servers, each for a share of the cars",
            },
        ),
        part(
            "judge",
            format!("{QUESTIONS_HZ} questions/s of {ANSWER_S} s"),
            QUESTIONS_HZ * ANSWER_S / ANSWERS_AT_ONCE,
            Remedy::More {
                how: "judges, each for a share of the cars; a late answer is no preference",
            },
        ),
        part(
            "new policies to the cars",
            format!("{:.0} kB every {POLICY_PERIOD_S:.0} s", POLICY_BYTES * 1e-3),
            POLICY_BYTES / POLICY_PERIOD_S / SERVER_BYTES_S,
            Remedy::More {
                how: "routers that pass a policy on",
            },
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::super::costs::flows;
    use super::*;

    #[test]
    fn the_part_with_the_largest_load_breaks_first_and_no_part_at_the_end() {
        let flows = flows().expect("flows");
        for (parts, members) in [(of_actors(), 10_000), (of_cars(&flows), 1000)] {
            let breaks = repair(&parts, members);
            let first = breaks.first().expect("it breaks");
            let most = parts.iter().map(|part| part.load(members));
            assert_eq!(first.load, most.fold(0.0, f64::max));
            for of in &breaks {
                assert!(of.load > 1.0 && of.load_after <= of.load, "{of:?}");
            }
            assert!(breaks.len() < REPAIRS_MAX);
        }
        assert_eq!(repair(&of_cars(&flows), 1), [], "one car breaks nothing");
    }

    #[test]
    fn a_part_is_full_with_the_members_that_it_names() {
        for part in of_actors().iter().filter(|part| !part.is_own) {
            let members = part.members_max().expect("a number");
            assert!(part.load(members as u64) <= 1.0, "{}", part.name);
            assert!(part.load(members as u64 + 1) > 1.0, "{}", part.name);
        }
    }
}
