//! Turns steps into transitions, with the label of the question they belong to.
//!
//! A transition needs the step after it: the step of the next tick, of the same world
//! and episode. After anything else (a lost step, a restarted process, another world)
//! the successor is unknown, and no state of one run leaks into another.
//!
//! A label holds for the window that its advice names: from the question's observation
//! for one period of asking, at most to the end of the episode, or until the answer to
//! a later question covers it. Answers come late, so transitions wait for them, for a
//! limited time.

use std::collections::VecDeque;

use shm_config::config::{Algorithm, GateMode};
use shm_config::message::{Driver, FEATURES, Preference, Reason, Step};
use vehicle::Action;

use crate::replay::{ACTIONS, INPUTS, Then, Transition};

/// Answers that are remembered. More come only from a judge that is asked more than ten
/// times a second for as long as a transition waits.
const WINDOWS_MAX: usize = 512;

/// The configuration of labels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Labelling {
    /// Which driver drives; the gate's mode.
    pub mode: GateMode,
    /// How long a transition waits for its answer, ns.
    pub wait_ns: u64,
    /// Ticks of an episode that the time limit ends, if that is no end of its value: its last
    /// step has a successor that nothing observed.
    pub truncated_at: Option<u64>,
}

/// Counts of steps and of the transitions made from them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Counts {
    /// Steps received.
    pub steps: u64,
    /// Steps that were published and not received.
    pub lost: u64,
    /// Steps without a new observation; they make no transition.
    pub unseen: u64,
    /// Transitions whose successor is unknown.
    pub cut: u64,
    /// Transitions whose label prefers the expert.
    pub expert: u64,
    /// Transitions whose label prefers the policy.
    pub policy: u64,
    /// Transitions without a label.
    pub unlabelled: u64,
    /// Steps at which the policy did not drive.
    pub interventions: u64,
    /// Imagined states at which the expert was asked; no step was driven there.
    pub imagined: u64,
}

impl Counts {
    /// Transitions made so far.
    pub fn transitions(&self) -> u64 {
        // A file may hold any numbers.
        self.expert
            .saturating_add(self.policy)
            .saturating_add(self.unlabelled)
    }

    /// Answers of the expert that this algorithm learns from: those of driven steps and
    /// those at imagined states.
    pub fn expert_queries(&self, algorithm: Algorithm) -> u64 {
        let driven = match algorithm {
            // The expert's action is the target of every step.
            Algorithm::Dagger => self.transitions(),
            Algorithm::Pvp | Algorithm::Ppl | Algorithm::Bc | Algorithm::HgDagger => self.expert,
        };
        driven.saturating_add(self.imagined)
    }

    /// Steps driven: received, or published while the learner was not connected.
    pub fn driven(&self) -> u64 {
        self.steps.saturating_add(self.lost)
    }

    /// The larger of the two values of each count. Both count the same steps from the
    /// same start, and one of them counted further.
    #[must_use]
    pub fn max(&self, other: &Counts) -> Counts {
        Counts {
            steps: self.steps.max(other.steps),
            lost: self.lost.max(other.lost),
            unseen: self.unseen.max(other.unseen),
            cut: self.cut.max(other.cut),
            expert: self.expert.max(other.expert),
            policy: self.policy.max(other.policy),
            unlabelled: self.unlabelled.max(other.unlabelled),
            interventions: self.interventions.max(other.interventions),
            imagined: self.imagined.max(other.imagined),
        }
    }
}

/// The controller that published a step, and the world it observed; both change when a
/// process restarts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Origin {
    controller: u32,
    world: u32,
}

/// The newest observation, and when the first step of its episode was received.
#[derive(Clone, Copy, Debug)]
struct Newest {
    world: u32,
    episode: u32,
    tick: u64,
    first_tick: Option<u64>,
    begun_ns: u64,
}

/// One received step.
#[derive(Clone, Debug)]
struct Seen {
    origin: Origin,
    episode: u32,
    tick: u64,
    /// That of the first step of its episode; `None` if that was missed.
    first_tick: Option<u64>,
    taken_ns: u64,
    /// When the first received step of its episode was taken, ns.
    begun_ns: u64,
    /// The label, if it depends on no answer.
    known: Option<Preference>,
    transition: Transition,
}

/// The steps that an answer labels.
#[derive(Clone, Copy, Debug)]
struct Window {
    from_ns: u64,
    to_ns: u64,
    label: Preference,
}

/// Takes steps, gives transitions.
pub struct Assembler {
    labelling: Labelling,
    counts: Counts,
    /// The controller and the sequence number of the last step.
    heard: Option<(u32, u64)>,
    answers: u64,
    /// When the last step was taken, ns.
    now_ns: u64,
    newest: Option<Newest>,
    last: Option<Seen>,
    /// Transitions that wait for their label, the oldest first.
    waiting: VecDeque<Seen>,
    windows: VecDeque<Window>,
}

impl Assembler {
    /// Continues from these counts.
    pub fn new(labelling: Labelling, counts: Counts) -> Assembler {
        Assembler {
            labelling,
            counts,
            heard: None,
            answers: 0,
            now_ns: 0,
            newest: None,
            last: None,
            waiting: VecDeque::new(),
            windows: VecDeque::with_capacity(WINDOWS_MAX),
        }
    }

    /// Counts of steps and transitions so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Sets the controller and the sequence number from which steps continue; numbers
    /// that are missing after it count as lost.
    pub fn follows(&mut self, (producer, sequence): (u32, u64)) {
        self.heard = Some((producer, sequence));
    }

    /// Controller and sequence number of the newest step.
    pub fn heard(&self) -> Option<(u32, u64)> {
        self.heard
    }

    /// Counts one imagined state at which the expert was asked.
    pub fn count_imagined(&mut self) {
        self.counts.imagined = self.counts.imagined.saturating_add(1);
    }

    /// Steps that become transitions once their successor and their label are known.
    pub fn waiting(&self) -> u64 {
        self.waiting.len() as u64 + u64::from(self.last.is_some())
    }

    /// Takes an admitted step; `out` receives the transitions that are now complete,
    /// the oldest first.
    pub fn push(&mut self, step: &Step, mut out: impl FnMut(Transition)) {
        // A clock that ran backwards belongs to another run.
        if step.header.taken_ns < self.now_ns {
            self.finish(&mut out);
            self.windows.clear();
            self.newest = None;
        }
        self.now_ns = step.header.taken_ns;
        self.count(step);
        self.learn_answer(step);
        let seen = self.see(step);
        let last = self.last.take();
        if let Some(mut last) = last {
            let then = seen
                .as_ref()
                .map_or(Then::Unknown, |seen| self.successor(&last, seen));
            if let (Then::On, Some(seen)) = (then, &seen) {
                last.transition.next = seen.transition.state;
            }
            last.transition.then = then;
            self.counts.cut += u64::from(then == Then::Unknown);
            self.waiting.push_back(last);
        }
        self.last = seen;
        self.release(step.header.taken_ns, &mut out);
    }

    /// Ends the run: each waiting transition gets its label if known, else none.
    pub fn finish(&mut self, mut out: impl FnMut(Transition)) {
        if let Some(mut last) = self.last.take() {
            last.transition.then = Then::Unknown;
            self.counts.cut += 1;
            self.waiting.push_back(last);
        }
        self.release(u64::MAX, &mut out);
    }

    fn count(&mut self, step: &Step) {
        let header = &step.header;
        // A new controller counts from 1; the steps that it published before the first
        // one received are lost too.
        let expected = match self.heard {
            Some((producer, sequence)) if producer == header.producer => sequence.saturating_add(1),
            Some(_) | None => 1,
        };
        let lost = header.sequence.saturating_sub(expected);
        self.counts.lost = self.counts.lost.saturating_add(lost);
        if self
            .heard
            .is_some_and(|(producer, _)| producer != header.producer)
        {
            self.answers = 0;
        }
        self.heard = Some((header.producer, header.sequence));
        self.counts.steps += 1;
        self.counts.interventions += u64::from(step.driver() != Driver::Policy);
    }

    /// A new answer opens a window of labels; an abstention labels nothing.
    fn learn_answer(&mut self, step: &Step) {
        let advice = &step.advice;
        if advice.answers == self.answers {
            return;
        }
        self.answers = advice.answers;
        if advice.answers == 0 {
            return;
        }
        if self.windows.len() == WINDOWS_MAX {
            self.windows.pop_front();
        }
        self.windows.push_back(Window {
            from_ns: advice.label_from_ns,
            to_ns: advice.label_until_ns,
            label: advice.label(),
        });
    }

    /// The step's part of a transition; `None` without a new observation.
    fn see(&mut self, step: &Step) -> Option<Seen> {
        let observation = &step.observation;
        let header = &observation.header;
        let origin = Origin {
            controller: step.header.producer,
            world: header.producer,
        };
        let before = self
            .newest
            .filter(|newest| newest.world == origin.world && newest.episode == header.episode);
        let is_old = before.is_some_and(|newest| header.tick <= newest.tick);
        let mut state = [0.0; INPUTS];
        state[FEATURES..].copy_from_slice(&step.motion);
        let sees = step.reason() != Some(Reason::Blind)
            && step.observation_age_ns != u64::MAX
            && observation.fits_policy();
        if is_old || !sees || observation.features(&mut state).is_none() {
            self.counts.unseen += 1;
            return None;
        }
        let begun_ns = before.map_or(header.taken_ns, |newest| newest.begun_ns);
        // An episode begins right after another one, or at the beginning of the run.
        let is_first = self
            .newest
            .map_or(Some(0), |newest| newest.tick.checked_add(1))
            .is_some_and(|first| first == header.tick);
        let first_tick = match before {
            Some(newest) => newest.first_tick,
            None => is_first.then_some(header.tick),
        };
        self.newest = Some(Newest {
            world: origin.world,
            episode: header.episode,
            tick: header.tick,
            first_tick,
            begun_ns,
        });
        let applied = pair(Action {
            steer: step.command.steer,
            pedal: step.command.pedal,
        });
        Some(Seen {
            origin,
            episode: header.episode,
            tick: header.tick,
            first_tick,
            taken_ns: header.taken_ns,
            begun_ns,
            known: self.known_label(step),
            transition: Transition {
                state,
                next: state,
                applied,
                policy: step.policy.action().map_or(applied, pair),
                expert: pair(expert_command(step)),
                label: Preference::Abstain,
                then: Then::Unknown,
            },
        })
    }

    /// The label of a step that needs no answer: the safety check vetoed the policy, a
    /// person or the expert took over, or the configuration leaves no choice. A step
    /// without a takeover has no label: it is unknown whether a person agreed or did not
    /// look (HG-DAgger and PVP take no preference from it either).
    fn known_label(&self, step: &Step) -> Option<Preference> {
        match (self.labelling.mode, step.reason()) {
            (GateMode::Expert, _) => Some(Preference::Expert),
            (GateMode::Human | GateMode::Takeover, Some(Reason::Takeover)) => {
                Some(Preference::Expert)
            }
            (_, Some(Reason::Vetoed)) => Some(Preference::Expert),
            (GateMode::Policy | GateMode::Human | GateMode::Takeover, _) => {
                Some(Preference::Abstain)
            }
            // A policy that proposed nothing cannot be preferred, and a late tick is
            // caused by the machine.
            (_, Some(Reason::Unloaded | Reason::Shadow | Reason::Faulty | Reason::Late)) => {
                Some(Preference::Abstain)
            }
            (
                GateMode::Rules
                | GateMode::Vlm
                | GateMode::Paper
                | GateMode::Distilled
                | GateMode::Replay,
                _,
            ) => None,
        }
    }

    /// The successor of a step, given the step that was received next.
    fn successor(&self, last: &Seen, next: &Seen) -> Then {
        if last.origin != next.origin || next.tick != last.tick.wrapping_add(1) {
            return Then::Unknown;
        }
        // An episode of unknown length may have reached the limit.
        let is_truncated = |limit| {
            last.first_tick
                .is_none_or(|first| next.tick.saturating_sub(first) >= limit)
        };
        if next.episode == last.episode {
            Then::On
        } else if next.episode != last.episode.wrapping_add(1)
            || self.labelling.truncated_at.is_some_and(is_truncated)
        {
            Then::Unknown
        } else {
            Then::End
        }
    }

    fn release(&mut self, now_ns: u64, out: &mut impl FnMut(Transition)) {
        while let Some(seen) = self.waiting.front() {
            let waited_ns = now_ns.saturating_sub(seen.taken_ns);
            let label = match seen.known.or_else(|| self.answered(seen)) {
                Some(label) => label,
                None if waited_ns > self.labelling.wait_ns => Preference::Abstain,
                None => return,
            };
            let Some(mut seen) = self.waiting.pop_front() else {
                return;
            };
            *match label {
                Preference::Expert => &mut self.counts.expert,
                Preference::Policy => &mut self.counts.policy,
                Preference::Abstain => &mut self.counts.unlabelled,
            } += 1;
            seen.transition.label = label;
            out(seen.transition);
        }
    }

    /// The label of the newest question whose window holds the step.
    fn answered(&self, seen: &Seen) -> Option<Preference> {
        let covers = |window: &&Window| {
            window.from_ns >= seen.begun_ns
                && (window.from_ns..window.to_ns).contains(&seen.taken_ns)
        };
        self.windows
            .iter()
            .rev()
            .find(covers)
            .map(|window| window.label)
    }
}

/// What the expert would have commanded: its proposal, but the brake if the safety
/// check vetoes it or there is none, as in [`controller::choose`]. The action of a
/// person is not vetoed.
///
/// [`controller::choose`]: ../../controller/fn.choose.html
pub fn expert_command(step: &Step) -> Action {
    match step.expert.action() {
        None => Action::BRAKE,
        Some(action) if step.reason() == Some(Reason::Takeover) => action,
        Some(action) if step.expert_assessment.is_vetoed() => Action {
            steer: action.steer,
            ..Action::BRAKE
        },
        Some(action) => action,
    }
}

fn pair(action: Action) -> [f32; ACTIONS] {
    [action.steer as f32, action.pedal as f32]
}
