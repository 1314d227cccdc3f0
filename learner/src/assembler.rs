//! Steps become transitions, with the label of the question they belong to.
//!
//! A transition needs the step after it: only one of the same world, episode and
//! the next tick is that. After anything else (a lost step, a restarted process,
//! a swap of worlds) it is not known what followed, and no run's state leaks
//! into another.
//!
//! A label holds for the window that its advice names: from the question's
//! observation for one period of asking, to the end of the episode at the
//! latest, or until a later question's answer covers it. Answers come late, so
//! transitions wait for theirs, for a limited time.

use std::collections::VecDeque;

use shm_config::config::GateMode;
use shm_config::message::{Driver, FEATURES, Preference, Reason, Step};
use vehicle::Action;

use crate::replay::{ACTIONS, Label, Then, Transition};

/// Answers that are remembered; more come only from a judge that is asked more
/// often than ten times a second for as long as a transition waits.
const WINDOWS_MAX: usize = 512;

/// How labels come about.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Labelling {
    /// Who decides who drives.
    pub mode: GateMode,
    /// How long a transition waits for its answer, ns.
    pub wait_ns: u64,
}

/// What became of the steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Counts {
    /// Steps received.
    pub steps: u64,
    /// Steps that were published and never received.
    pub lost: u64,
    /// Steps that are no transition: the car saw nothing new.
    pub unseen: u64,
    /// Transitions of which nobody knows what followed.
    pub cut: u64,
    /// Transitions whose label prefers the expert.
    pub expert: u64,
    /// Transitions whose label prefers the policy.
    pub policy: u64,
    /// Transitions without a label.
    pub unlabelled: u64,
    /// Steps at which the policy did not drive.
    pub interventions: u64,
}

impl Counts {
    /// Transitions made.
    pub fn transitions(&self) -> u64 {
        self.expert + self.policy + self.unlabelled
    }

    /// Steps driven: received, and published while nobody listened.
    pub fn driven(&self) -> u64 {
        self.steps + self.lost
    }

    /// The larger of the two for each count: both count the same steps from the same
    /// start, one of them further.
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
        }
    }
}

/// Who published a step, and the world it saw: both start anew when restarted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Origin {
    controller: u32,
    world: u32,
}

/// The newest observation that was seen, and when its episode began here.
#[derive(Clone, Copy, Debug)]
struct Newest {
    world: u32,
    episode: u32,
    tick: u64,
    begun_ns: u64,
}

/// One step, seen.
#[derive(Clone, Debug)]
struct Seen {
    origin: Origin,
    episode: u32,
    tick: u64,
    taken_ns: u64,
    /// When the first step of its episode was taken that came here, ns.
    begun_ns: u64,
    /// The label, when it depends on no answer.
    known: Option<Label>,
    transition: Transition,
}

/// What an answer is about.
#[derive(Clone, Copy, Debug)]
struct Window {
    from_ns: u64,
    to_ns: u64,
    label: Label,
}

/// Steps in, transitions out.
pub struct Assembler {
    labelling: Labelling,
    counts: Counts,
    /// The sequence number of the last step, and who published it.
    heard: Option<(u32, u64)>,
    answers: u64,
    /// When the last step was taken, ns.
    now_ns: u64,
    newest: Option<Newest>,
    last: Option<Seen>,
    /// Complete, but for the label; the oldest first.
    waiting: VecDeque<Seen>,
    windows: VecDeque<Window>,
}

impl Assembler {
    /// Goes on counting from these counts.
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

    /// What became of the steps so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Sequence numbers follow on from this one, of this publisher: what is
    /// missing in between was lost.
    pub fn follows(&mut self, (producer, sequence): (u32, u64)) {
        self.heard = Some((producer, sequence));
    }

    /// Publisher and sequence number of the newest step.
    pub fn heard(&self) -> Option<(u32, u64)> {
        self.heard
    }

    /// Steps that will be transitions when it is known what followed and whom
    /// the judge preferred.
    pub fn waiting(&self) -> u64 {
        self.waiting.len() as u64 + u64::from(self.last.is_some())
    }

    /// Takes in a step that was checked at the door; `out` gets the transitions
    /// that are complete now, the oldest first.
    pub fn push(&mut self, step: &Step, mut out: impl FnMut(Transition)) {
        // A clock that ran backwards is that of another run.
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
                .map_or(Then::Unknown, |seen| follows(&last, seen));
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

    /// Ends the run: what waits gets the label that is known, or none.
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
        // A new publisher counts from 1; what it published unheard is lost too.
        let expected = match self.heard {
            Some((producer, sequence)) if producer == header.producer => sequence + 1,
            Some(_) | None => 1,
        };
        self.counts.lost += header.sequence.saturating_sub(expected);
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

    /// A new answer opens a window of labels; an abstention's label is none.
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
            label: match advice.label() {
                Preference::Expert => Label::Expert,
                Preference::Policy => Label::Policy,
                Preference::Abstain => Label::None,
            },
        });
    }

    /// The step's own part of a transition; `None` when the car saw nothing new.
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
        let mut state = [0.0; FEATURES];
        let sees = step.reason() != Some(Reason::Blind)
            && step.observation_age_ns != u64::MAX
            && observation.feature_count() == FEATURES;
        if is_old || !sees || observation.features(&mut state).is_none() {
            self.counts.unseen += 1;
            return None;
        }
        let begun_ns = before.map_or(header.taken_ns, |newest| newest.begun_ns);
        self.newest = Some(Newest {
            world: origin.world,
            episode: header.episode,
            tick: header.tick,
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
            taken_ns: header.taken_ns,
            begun_ns,
            known: self.known_label(step),
            transition: Transition {
                state,
                next: state,
                applied,
                policy: step.policy.action().map_or(applied, pair),
                expert: pair(expert_command(step)),
                label: Label::None,
                then: Then::Unknown,
            },
        })
    }

    /// The label of a step that needs no answer: the judge in the tick refused
    /// the policy, a person took over, or the configuration leaves no choice. Where
    /// a person watched and let the policy drive, that is no label: nobody can say
    /// whether they agreed or had not looked up yet (HG-DAgger and PVP take no
    /// preference from it either).
    fn known_label(&self, step: &Step) -> Option<Label> {
        match (self.labelling.mode, step.reason()) {
            (GateMode::Expert, _) => Some(Label::Expert),
            (GateMode::Human, Some(Reason::Takeover)) => Some(Label::Expert),
            (_, Some(Reason::Vetoed)) => Some(Label::Expert),
            (GateMode::Policy | GateMode::Human, _) => Some(Label::None),
            // Nobody can prefer a policy that proposed nothing; and of a late tick
            // only the machine is to blame.
            (_, Some(Reason::Unloaded | Reason::Shadow | Reason::Faulty | Reason::Late)) => {
                Some(Label::None)
            }
            (GateMode::Rules | GateMode::Vlm | GateMode::Paper | GateMode::Replay, _) => None,
        }
    }

    fn release(&mut self, now_ns: u64, out: &mut impl FnMut(Transition)) {
        while let Some(seen) = self.waiting.front() {
            let waited_ns = now_ns.saturating_sub(seen.taken_ns);
            let label = match seen.known.or_else(|| self.answered(seen)) {
                Some(label) => label,
                None if waited_ns > self.labelling.wait_ns => Label::None,
                None => return,
            };
            let Some(mut seen) = self.waiting.pop_front() else {
                return;
            };
            *match label {
                Label::Expert => &mut self.counts.expert,
                Label::Policy => &mut self.counts.policy,
                Label::None => &mut self.counts.unlabelled,
            } += 1;
            seen.transition.label = label;
            out(seen.transition);
        }
    }

    /// The label of the newest question whose window holds the step.
    fn answered(&self, seen: &Seen) -> Option<Label> {
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

/// What the expert would have commanded: its proposal, with the brake where the
/// judge in the tick vetoes it, as [`controller::choose`] has it. No proposal is
/// the brake, too. A person is not vetoed.
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

/// What followed a step, by the step that came next.
fn follows(last: &Seen, next: &Seen) -> Then {
    if last.origin != next.origin {
        Then::Unknown
    } else if next.episode == last.episode && next.tick == last.tick.wrapping_add(1) {
        Then::On
    } else if next.episode == last.episode.wrapping_add(1) && next.tick == last.tick.wrapping_add(1)
    {
        Then::End
    } else {
        Then::Unknown
    }
}

fn pair(action: Action) -> [f32; ACTIONS] {
    [action.steer as f32, action.pedal as f32]
}
