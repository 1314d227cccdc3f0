use super::{Header, Message, Refusal, header_accessors, known};

crate::word_list! {
    /// What a judge prefers.
    pub enum Preference {
        /// No preference: no question yet, the judges disagreed, or they failed.
        /// It is never read as a preference for the policy, and makes no label.
        Abstain = 0 "abstain",
        /// `z = 1` of Sec. 4.2: the expert's rollout is safer.
        Expert = 1 "expert",
        /// `z = 0` of Sec. 4.2: the policy's rollout is as safe or safer.
        Policy = 2 "policy",
    }
}

crate::word_list! {
    /// What kind of judge answered.
    pub enum Judge {
        /// No judge has answered yet.
        None = 0 "none",
        /// Exact geometry.
        Rules = 1 "rules",
        /// A vision-language model.
        Vlm = 2 "vlm",
        /// A person.
        Human = 3 "human",
        /// Answers from a recording.
        Recorded = 5 "recorded",
        /// A net distilled from recorded answers, with a slow judge behind it.
        Distilled = 6 "distilled",
    }
}

crate::message! {
    /// Which driver should drive, and until when. Published for every step that the gate
    /// has read, so that lockstep can wait for it; the answer itself changes rarely.
    #[derive(Default)]
    pub struct Advice: 112 bytes, nested [Header] {
        /// The tick of the last step that the gate has read.
        pub header: Header,
        /// The tick the judge was asked about.
        pub question_tick: u64,
        /// When the observation of the question was taken, ns.
        pub question_taken_ns: u64,
        /// When the answer arrived, ns on the run's clock.
        pub answered_ns: u64,
        /// The first instant at which the advice no longer holds, ns.
        pub holds_until_ns: u64,
        /// When the gate considered the step, ns on the run's clock: its answers and their
        /// hysteresis depend on it, so that advice can be recomputed.
        pub considered_ns: u64,
        /// Questions answered so far, failures and abstentions included.
        pub answers: u64,
        /// A [`Preference`]: the driver to choose, after dwell time and confirmations.
        pub preference: u32,
        /// A [`Judge`].
        pub judge: u32,
        /// The steps that the newest answer labels begin here: when the observation of
        /// its question was taken, ns.
        pub label_from_ns: u64,
        /// They end before this instant, ns.
        pub label_until_ns: u64,
        /// A [`Preference`]: the newest answer.
        pub label: u32,
        /// Not used.
        pub reserved: u32,
    }
}

impl Message for Advice {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        known("preference", self.preference, Preference::from_code)?;
        known("label", self.label, Preference::from_code)?;
        known("judge", self.judge, Judge::from_code)
    }
}

impl Advice {
    /// The judge's preference; an unknown code is an abstention.
    pub fn preference(&self) -> Preference {
        Preference::from_code(self.preference).unwrap_or(Preference::Abstain)
    }

    /// What the newest answer teaches; an unknown code abstains.
    pub fn label(&self) -> Preference {
        Preference::from_code(self.label).unwrap_or(Preference::Abstain)
    }
}
