//! Replay buffers: the transitions from which the algorithms learn.
//!
//! There are two buffers, as in Sec. 4.3: steps whose label prefers the expert, and all
//! others. Both are sampled evenly, so that a policy that has become good does not
//! forget the expert's corrections. A third buffer holds predicted states, which were
//! never visited, with the expert's answer there.

use rand::{Rng, RngExt};
use shm_config::message::{FEATURES, INPUTS_WITH_MOTION, Preference};

use crate::features;
use crate::network::ROWS;
use crate::share::share;

/// Numbers in an action: steering, pedal.
pub const ACTIONS: usize = 2;

/// Numbers in a state: the features of the observation, then how bodies move, which not
/// every policy takes.
pub const INPUTS: usize = INPUTS_WITH_MOTION;

/// The successor of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Then {
    /// Another step of the same episode.
    On,
    /// The end of the episode; reaching the time limit counts as an end if
    /// `learner.truncate_as_terminate` is true.
    End,
    /// Unknown, because the next step was lost, or the time limit ended the episode.
    Unknown,
}

/// One step with all that the algorithms use.
#[derive(Clone, Debug, PartialEq)]
pub struct Transition {
    /// What the policy's input is taken from.
    pub state: [f32; INPUTS],
    /// The same one step later; equal to `state` without a successor.
    pub next: [f32; INPUTS],
    /// The action that the car applied.
    pub applied: [f32; ACTIONS],
    /// The policy's proposal; the applied action if there was none.
    pub policy: [f32; ACTIONS],
    /// What the expert would have commanded, the brake of a veto included.
    pub expert: [f32; ACTIONS],
    /// The judge's preference; [`Preference::Abstain`] if there is no label.
    pub label: Preference,
    /// The successor.
    pub then: Then,
}

/// The replay buffers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Buffer {
    /// Steps whose label prefers the expert.
    Expert,
    /// All other steps.
    Learner,
    /// Predicted states; `expert` is the expert's answer, `policy` the rejected action.
    Predicted,
}

impl Buffer {
    /// All of them.
    pub const ALL: [Buffer; 3] = [Buffer::Expert, Buffer::Learner, Buffer::Predicted];
}

impl Transition {
    /// The buffer it belongs to.
    pub fn buffer(&self) -> Buffer {
        match self.label {
            Preference::Expert => Buffer::Expert,
            Preference::Policy | Preference::Abstain => Buffer::Learner,
        }
    }
}

/// The replay buffers with their transitions.
#[derive(Clone, Debug)]
pub struct Replay {
    capacity: usize,
    /// Of each state the networks take so many numbers.
    inputs: usize,
    buffers: [Vec<Transition>; 3],
    /// Transitions ever put into each buffer.
    counts: [u64; 3],
}

/// Whether a transition is mirrored. Driving is symmetric, so mirroring doubles the
/// data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Reflection {
    None,
    Mirrored,
}

impl Reflection {
    fn draw(random: &mut impl Rng) -> Reflection {
        match random.random() {
            true => Reflection::Mirrored,
            false => Reflection::None,
        }
    }
}

/// Transitions drawn for one update, each as recorded or mirrored; row by row, with
/// states as the networks take them ([`features::prepare`]).
#[derive(Clone, Debug, Default)]
pub struct Batch {
    /// `batch x inputs`.
    pub states: Vec<f32>,
    /// `batch x inputs`; empty in a batch of [`Replay::sample`].
    pub nexts: Vec<f32>,
    /// `batch x ACTIONS`.
    pub applied: Vec<f32>,
    /// `batch x ACTIONS`.
    pub policy: Vec<f32>,
    /// `batch x ACTIONS`.
    pub expert: Vec<f32>,
    /// 1 where the label prefers the expert and the expert drove, else 0. If the policy
    /// was already driving when the answer came, the preferred action was never taken.
    pub is_preferred: Vec<f32>,
    /// 1 where the episode continued, 0 where it ended.
    pub goes_on: Vec<f32>,
    /// 1 where the successor is known, else 0.
    pub is_known: Vec<f32>,
}

impl Batch {
    /// Number of transitions.
    pub fn len(&self) -> usize {
        self.goes_on.len()
    }

    /// Whether it holds no transition.
    pub fn is_empty(&self) -> bool {
        self.goes_on.is_empty()
    }

    /// Clears all but the states, whose rows are overwritten.
    fn clear(&mut self) {
        self.applied.clear();
        self.policy.clear();
        self.expert.clear();
        self.is_preferred.clear();
        self.goes_on.clear();
        self.is_known.clear();
    }

    /// Appends all of a transition but its states, as recorded or mirrored.
    fn push(&mut self, drawn: &Draw) {
        let Draw {
            transition,
            reflection,
        } = drawn;
        for (actions, mut action) in [
            (&mut self.applied, transition.applied),
            (&mut self.policy, transition.policy),
            (&mut self.expert, transition.expert),
        ] {
            if *reflection == Reflection::Mirrored {
                features::mirror_action(&mut action);
            }
            actions.extend_from_slice(&action);
        }
        let one_if = |condition| if condition { 1.0 } else { 0.0 };
        let obeyed = transition.applied != transition.policy;
        self.is_preferred
            .push(one_if(transition.label == Preference::Expert && obeyed));
        self.goes_on.push(one_if(transition.then == Then::On));
        self.is_known.push(one_if(transition.then != Then::Unknown));
    }
}

/// A transition that was drawn for a batch.
#[derive(Clone, Copy)]
struct Draw<'a> {
    transition: &'a Transition,
    reflection: Reflection,
}

impl<'a> Draw<'a> {
    fn of(transition: &'a Transition, random: &mut impl Rng) -> Self {
        Draw {
            transition,
            reflection: Reflection::draw(random),
        }
    }
}

/// Writes states of drawn transitions, `rows x inputs`, as the networks take them.
fn write_states(
    states: &mut Vec<f32>,
    (drawn, inputs): (&[Draw], usize),
    threads: usize,
    state: impl Fn(&Transition) -> &[f32; INPUTS] + Sync,
) {
    states.resize(drawn.len() * inputs, 0.0);
    let parts = states.chunks_mut(ROWS * inputs).zip(drawn.chunks(ROWS));
    share(threads, parts, |(states, drawn)| {
        for (out, drawn) in states.chunks_exact_mut(inputs).zip(drawn) {
            out.copy_from_slice(&state(drawn.transition)[..inputs]);
            if drawn.reflection == Reflection::Mirrored {
                features::mirror(out);
            }
            features::prepare(out);
        }
    });
}

impl Replay {
    /// Empty buffers of this capacity each.
    pub fn new(capacity: usize) -> Replay {
        Replay {
            capacity: capacity.max(1),
            inputs: FEATURES,
            buffers: [const { Vec::new() }; 3],
            counts: [0; 3],
        }
    }

    /// Sets how many numbers of each state the networks take: [`FEATURES`], or
    /// [`INPUTS`] with how bodies move.
    pub fn set_inputs(&mut self, inputs: usize) {
        self.inputs = inputs.clamp(FEATURES, INPUTS);
    }

    /// Adds a transition to a buffer; in a full buffer it replaces the oldest one.
    pub fn push(&mut self, buffer: Buffer, transition: Transition) {
        let (held, count) = (
            &mut self.buffers[buffer as usize],
            &mut self.counts[buffer as usize],
        );
        match held.len() < self.capacity {
            true => held.push(transition),
            false => held[(*count % self.capacity as u64) as usize] = transition,
        }
        *count += 1;
    }

    /// The capacity of each buffer, transitions.
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// Number of transitions in a buffer.
    pub fn len(&self, buffer: Buffer) -> usize {
        self.buffers[buffer as usize].len()
    }

    /// Number of transitions of a buffer that later ones have replaced.
    pub fn replaced(&self, buffer: Buffer) -> u64 {
        self.counts[buffer as usize] - self.len(buffer) as u64
    }

    /// Whether all buffers are empty.
    pub fn is_empty(&self) -> bool {
        self.buffers.iter().all(Vec::is_empty)
    }

    /// The transitions of a buffer, the oldest first.
    pub fn iter(&self, buffer: Buffer) -> impl Iterator<Item = &Transition> {
        let held = &self.buffers[buffer as usize];
        let oldest = match held.len() < self.capacity {
            true => 0,
            false => (self.counts[buffer as usize] % self.capacity as u64) as usize,
        };
        held[oldest..].iter().chain(&held[..oldest])
    }

    /// Draws this many steps, with replacement: half of them from those that prefer the
    /// expert and half from the others, or all from the only buffer that is not empty
    /// (Sec. 4.3). At most so many threads copy them, which changes no bit.
    pub fn sample_evenly(
        &self,
        size: usize,
        random: &mut impl Rng,
        threads: usize,
        batch: &mut Batch,
    ) {
        batch.clear();
        let buffers: &[Buffer] = match (self.len(Buffer::Expert), self.len(Buffer::Learner)) {
            (0, 0) => &[],
            (_, 0) => &[Buffer::Expert],
            (0, _) => &[Buffer::Learner],
            // In turn, so that threads that share a batch have as many rows of either.
            (_, _) => &[Buffer::Learner, Buffer::Expert],
        };
        let mut drawn = Vec::with_capacity(size);
        for &buffer in buffers.iter().cycle().take(size) {
            let held = &self.buffers[buffer as usize];
            let transition = &held[random.random_range(0..held.len())];
            drawn.push(Draw::of(transition, random));
        }
        self.write(&drawn, threads, batch);
        let drawn = (&drawn[..], self.inputs);
        write_states(&mut batch.nexts, drawn, threads, |held| &held.next);
    }

    /// Draws this many transitions from these buffers as if they were one, with
    /// replacement and without what followed them; none when all of them are empty. At most so
    /// many threads copy them, which changes no bit.
    pub fn sample(
        &self,
        buffers: &[Buffer],
        size: usize,
        random: &mut impl Rng,
        threads: usize,
        batch: &mut Batch,
    ) {
        batch.clear();
        let total: usize = buffers.iter().map(|&buffer| self.len(buffer)).sum();
        let size = if total == 0 { 0 } else { size };
        let mut drawn = Vec::with_capacity(size);
        for _ in 0..size {
            let mut k = random.random_range(0..total);
            for &buffer in buffers {
                match self.buffers[buffer as usize].get(k) {
                    Some(transition) => {
                        drawn.push(Draw::of(transition, random));
                        break;
                    }
                    None => k -= self.len(buffer),
                }
            }
        }
        self.write(&drawn, threads, batch);
        batch.nexts.clear();
    }

    /// Fills a batch, except for what followed.
    fn write(&self, drawn: &[Draw], threads: usize, batch: &mut Batch) {
        drawn.iter().for_each(|drawn| batch.push(drawn));
        let drawn = (drawn, self.inputs);
        write_states(&mut batch.states, drawn, threads, |held| &held.state);
    }
}
