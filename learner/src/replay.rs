//! What the car lived through, ready to be learnt from.
//!
//! Two rings, as in Sec. 4.3: steps whose label prefers the expert, and all
//! others. They are sampled evenly, so that a policy which has become good does
//! not forget what it was told. A third ring holds states that were never
//! visited, only predicted, and the expert's answer there.

use rand::{Rng, RngExt};
use shm_config::message::FEATURES;

use crate::features;

/// Numbers of an action: steering, pedal.
pub const ACTIONS: usize = 2;

/// Whom the judge preferred at a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Label {
    /// Nobody: it abstained, failed, or was never asked.
    None,
    /// The expert: `z = 1`.
    Expert,
    /// The policy: `z = 0`.
    Policy,
}

/// What followed a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Then {
    /// Another step of the same episode.
    On,
    /// The end of the episode, running out of time included.
    End,
    /// Nobody knows: the next step was lost.
    Unknown,
}

/// One step, as it is learnt from.
#[derive(Clone, Debug, PartialEq)]
pub struct Transition {
    /// The policy's input.
    pub state: [f32; FEATURES],
    /// The input one step later; that of the state itself when nothing followed.
    pub next: [f32; FEATURES],
    /// What was obeyed.
    pub applied: [f32; ACTIONS],
    /// What the policy proposed; what was obeyed when it proposed nothing.
    pub policy: [f32; ACTIONS],
    /// What the expert would have commanded, its brake included.
    pub expert: [f32; ACTIONS],
    /// Whom the judge preferred.
    pub label: Label,
    /// What followed.
    pub then: Then,
}

/// Which of the rings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ring {
    /// Steps whose label prefers the expert.
    Expert,
    /// All other steps.
    Learner,
    /// States that were predicted; `expert` is what the expert answered there,
    /// `policy` what was rejected.
    Predicted,
}

impl Ring {
    /// All of them.
    pub const ALL: [Ring; 3] = [Ring::Expert, Ring::Learner, Ring::Predicted];
}

impl Transition {
    /// The ring it belongs to.
    pub fn ring(&self) -> Ring {
        match self.label {
            Label::Expert => Ring::Expert,
            Label::Policy | Label::None => Ring::Learner,
        }
    }
}

/// The rings.
#[derive(Clone, Debug)]
pub struct Replay {
    capacity: usize,
    rings: [Vec<Transition>; 3],
    /// Transitions ever put into each.
    counts: [u64; 3],
}

/// How a transition is looked at: driving is the same in a mirror, which doubles
/// what there is to learn from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Seen {
    Plainly,
    Mirrored,
}

impl Seen {
    fn draw(random: &mut impl Rng) -> Seen {
        match random.random() {
            true => Seen::Mirrored,
            false => Seen::Plainly,
        }
    }
}

/// Transitions drawn for one update, each as it was or in the mirror; rows one
/// after the other, states as the networks get them ([`features::prepare`]).
#[derive(Clone, Debug, Default)]
pub struct Batch {
    /// `batch x FEATURES`.
    pub states: Vec<f32>,
    /// `batch x FEATURES`.
    pub nexts: Vec<f32>,
    /// `batch x ACTIONS`.
    pub applied: Vec<f32>,
    /// `batch x ACTIONS`.
    pub policy: Vec<f32>,
    /// `batch x ACTIONS`.
    pub expert: Vec<f32>,
    /// 1 where the label prefers the expert, and it drove, else 0: of an answer
    /// that came when the policy had driven already, the preferred action was
    /// never taken.
    pub is_preferred: Vec<f32>,
    /// 1 where the episode went on, 0 where it ended.
    pub goes_on: Vec<f32>,
    /// 1 where it is known what followed, else 0.
    pub is_known: Vec<f32>,
}

impl Batch {
    /// How many transitions it holds.
    pub fn len(&self) -> usize {
        self.goes_on.len()
    }

    /// It holds none.
    pub fn is_empty(&self) -> bool {
        self.goes_on.is_empty()
    }

    fn clear(&mut self) {
        self.states.clear();
        self.nexts.clear();
        self.applied.clear();
        self.policy.clear();
        self.expert.clear();
        self.is_preferred.clear();
        self.goes_on.clear();
        self.is_known.clear();
    }

    /// Appends a transition, as it is or in the mirror.
    fn push(&mut self, transition: &Transition, seen: Seen) {
        for (states, mut state) in [
            (&mut self.states, transition.state),
            (&mut self.nexts, transition.next),
        ] {
            if seen == Seen::Mirrored {
                features::mirror(&mut state);
            }
            features::prepare(&mut state);
            states.extend_from_slice(&state);
        }
        for (actions, mut action) in [
            (&mut self.applied, transition.applied),
            (&mut self.policy, transition.policy),
            (&mut self.expert, transition.expert),
        ] {
            if seen == Seen::Mirrored {
                features::mirror_action(&mut action);
            }
            actions.extend_from_slice(&action);
        }
        let one_if = |condition| if condition { 1.0 } else { 0.0 };
        let obeyed = transition.applied != transition.policy;
        self.is_preferred
            .push(one_if(transition.label == Label::Expert && obeyed));
        self.goes_on.push(one_if(transition.then == Then::On));
        self.is_known.push(one_if(transition.then != Then::Unknown));
    }
}

impl Replay {
    /// Empty rings of this capacity each.
    pub fn new(capacity: usize) -> Replay {
        Replay {
            capacity: capacity.max(1),
            rings: [const { Vec::new() }; 3],
            counts: [0; 3],
        }
    }

    /// Puts a transition into a ring, in place of the oldest of a full one.
    pub fn push(&mut self, ring: Ring, transition: Transition) {
        let (held, count) = (
            &mut self.rings[ring as usize],
            &mut self.counts[ring as usize],
        );
        match held.len() < self.capacity {
            true => held.push(transition),
            false => held[(*count % self.capacity as u64) as usize] = transition,
        }
        *count += 1;
    }

    /// Transitions that each ring can hold.
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// Transitions in a ring now.
    pub fn len(&self, ring: Ring) -> usize {
        self.rings[ring as usize].len()
    }

    /// All rings are empty.
    pub fn is_empty(&self) -> bool {
        self.rings.iter().all(Vec::is_empty)
    }

    /// A ring's transitions, the oldest first.
    pub fn iter(&self, ring: Ring) -> impl Iterator<Item = &Transition> {
        let held = &self.rings[ring as usize];
        let oldest = match held.len() < self.capacity {
            true => 0,
            false => (self.counts[ring as usize] % self.capacity as u64) as usize,
        };
        held[oldest..].iter().chain(&held[..oldest])
    }

    /// Draws this many steps, with replacement: half of those that prefer the
    /// expert and half of the others, or all from the only ring that holds any
    /// (Sec. 4.3).
    pub fn sample_evenly(&self, size: usize, random: &mut impl Rng, batch: &mut Batch) {
        batch.clear();
        let expert = match (self.len(Ring::Expert), self.len(Ring::Learner)) {
            (0, 0) => return,
            (_, 0) => size,
            (0, _) => 0,
            (_, _) => size / 2,
        };
        for (ring, share) in [(Ring::Expert, expert), (Ring::Learner, size - expert)] {
            let held = &self.rings[ring as usize];
            for _ in 0..share {
                let transition = &held[random.random_range(0..held.len())];
                batch.push(transition, Seen::draw(random));
            }
        }
    }

    /// Draws this many of these rings as if they were one, with replacement;
    /// none when all of them are empty.
    pub fn sample(&self, rings: &[Ring], size: usize, random: &mut impl Rng, batch: &mut Batch) {
        batch.clear();
        let total: usize = rings.iter().map(|&ring| self.len(ring)).sum();
        if total == 0 {
            return;
        }
        for _ in 0..size {
            let mut k = random.random_range(0..total);
            for &ring in rings {
                match self.rings[ring as usize].get(k) {
                    Some(transition) => {
                        batch.push(transition, Seen::draw(random));
                        break;
                    }
                    None => k -= self.len(ring),
                }
            }
        }
    }
}
