use vehicle::Action;

use super::{
    Advice, Before, Command, Driver, Entry, Header, Intent, Lateness, MOTION_AT_REST,
    MOTION_FEATURES, Message, Observation, Plan, Reason, Refusal, Stage, Takeover,
    header_accessors, known, within,
};

/// A late tick at most this long after another one is part of the same event, ns: under load
/// every tick may be late.
pub const LATE_APART_NS: u64 = 1_000_000_000;

crate::word_list! {
    /// The safety check's verdict on one proposal.
    pub enum Verdict {
        /// There was no proposal to check.
        Absent = 0 "absent",
        /// Its rollout touches nothing and stays on the road.
        Clear = 1 "clear",
        /// Its rollout leaves the road.
        Leaves = 2 "leaves",
        /// Its rollout meets an obstacle.
        Hits = 3 "hits",
    }
}

crate::message! {
    /// One driver's proposal.
    #[derive(Default)]
    pub struct Proposal: 24 bytes {
        /// Steering, normalised.
        pub steer: f64,
        /// Pedal, normalised.
        pub pedal: f64,
        /// 1 when there is a proposal, else 0.
        pub present: u32,
        /// Not used.
        pub reserved: u32,
    }
}

crate::message! {
    /// The safety check's measurements of one proposal's rollout.
    #[derive(Default)]
    pub struct Assessment: 40 bytes {
        /// Least distance between footprint and any lidar return, m; negative
        /// inside; `CLEARANCE_MAX_M` when none is near.
        pub clearance_m: f64,
        /// Time to the first contact or to leaving the road, s; the horizon
        /// when there is none.
        pub safe_s: f64,
        /// Least distance between the car's centre line corners and the road's
        /// edge, m; negative beyond it.
        pub edge_m: f64,
        /// Progress towards the next checkpoint, m.
        pub progress_m: f64,
        /// A [`Verdict`].
        pub verdict: u32,
        /// 1 when the safety check vetoes this proposal, else 0.
        pub veto: u32,
    }
}

crate::message! {
    /// The instants of a tick, ns on the machine's clock, also in lockstep.
    #[derive(Default)]
    pub struct Timings: 48 bytes {
        /// The instant of the grid at which this tick was due.
        pub scheduled_ns: u64,
        /// When the world's tick began; 0 when there was no observation.
        pub released_ns: u64,
        /// When the controller began the tick.
        pub started_ns: u64,
        /// When the plan had arrived, or the wait for it ended.
        pub planned_ns: u64,
        /// When proposals and verdicts were complete.
        pub decided_ns: u64,
        /// When the command was sent.
        pub commanded_ns: u64,
    }
}

crate::message! {
    /// The proposal of the weights in shadow mode for the tick's observation, computed
    /// after its command was sent.
    #[derive(Default)]
    pub struct ShadowProposal: 80 bytes, nested [Proposal, Assessment] {
        /// Their proposal.
        pub proposal: Proposal,
        /// Its verdict.
        pub assessment: Assessment,
        /// Their version; 0 when none were asked.
        pub weights_version: u64,
        /// First 8 bytes of their SHA-256; 0 for none.
        pub weights_hash: u64,
    }
}

crate::message! {
    /// The record of one tick of the controller: everything known and decided. From it
    /// and the run's configuration the tick can be recomputed bit by bit
    /// (`controller::Recomputer`).
    pub struct Step: 11872 bytes,
        nested [
            Header, Before, Entry, Observation, Plan, Advice, Takeover, Proposal, Assessment,
            ShadowProposal, Command, Timings
        ]
    {
        /// The controller's tick; taken when it admitted its inputs.
        pub header: Header,
        /// The state with which it began.
        pub before: Before,
        /// The check of the observation.
        pub observation_entry: Entry,
        /// The check of the plan.
        pub plan_entry: Entry,
        /// The check of the advice.
        pub advice_entry: Entry,
        /// The check of the takeover.
        pub takeover_entry: Entry,
        /// The plan; the last admitted one when none arrived.
        pub plan: Plan,
        /// The advice in force.
        pub advice: Advice,
        /// The newest takeover message.
        pub takeover: Takeover,
        /// The expert's proposal, or the person's action after a takeover.
        pub expert: Proposal,
        /// The proposal of the active policy.
        pub policy: Proposal,
        /// The safety check of the expert's proposal.
        pub expert_assessment: Assessment,
        /// The safety check of the policy's proposal.
        pub policy_assessment: Assessment,
        /// The proposal of the policy in shadow mode.
        pub shadow: ShadowProposal,
        /// The command, its driver and its reason.
        pub command: Command,
        /// The instants of the tick.
        pub timings: Timings,
        /// Age of the observation, ns; `u64::MAX` when there is none.
        pub observation_age_ns: u64,
        /// Age of the plan, ns; `u64::MAX` when there is none.
        pub plan_age_ns: u64,
        /// Age of the advice's question, ns; `u64::MAX` when there is none.
        pub advice_age_ns: u64,
        /// Version of the weights that proposed; 0 for none.
        pub weights_version: u64,
        /// First 8 bytes of their SHA-256; 0 for none.
        pub weights_hash: u64,
        /// Ticks of the grid the controller skipped since it started.
        pub skipped: u64,
        /// Messages the controller refused since it started.
        pub refused: u64,
        /// Messages that the ports refused since the tick before.
        pub refused_at_ports: u64,
        /// An [`Intent`]: what the process asked of the tick.
        pub intent: u32,
        /// A [`Stage`]: of the policy.
        pub stage: u32,
        /// 1 when a person's action replaces the expert's, else 0.
        pub takeover_used: u32,
        /// A [`Lateness`]: of the command.
        pub lateness: u32,
        /// How the bodies of the observation move, as a policy takes it: for each of 60 sectors
        /// the velocity of the nearest return, forward and to the left, where 0 is -20 m/s, 0.5
        /// is rest and 1 is 20 m/s. All at rest unless a policy is loaded that takes it.
        pub motion: [f32; 120],
        /// The observation; the last admitted one when none arrived. It ends the step, so that
        /// beams which the scanner does not have are not sent.
        pub observation: Observation,
    }
}

impl Proposal {
    /// A driver's answer, or its absence.
    pub fn new(action: Option<Action>) -> Self {
        match action {
            Some(Action { steer, pedal }) => Self {
                steer,
                pedal,
                present: 1,
                reserved: 0,
            },
            None => Self::default(),
        }
    }

    /// The action; `None` without a proposal.
    pub fn action(&self) -> Option<Action> {
        (self.present == 1).then_some(Action {
            steer: self.steer,
            pedal: self.pedal,
        })
    }

    pub(super) fn check(&self, field: &'static str) -> Result<(), Refusal> {
        within(field, self.steer, -1.0..=1.0)?;
        within(field, self.pedal, -1.0..=1.0)
    }
}

impl Assessment {
    /// The verdict; an unknown code is read as a hit.
    pub fn verdict(&self) -> Verdict {
        Verdict::from_code(self.verdict).unwrap_or(Verdict::Hits)
    }

    /// Whether the safety check vetoes the proposal.
    pub fn is_vetoed(&self) -> bool {
        self.veto != 0
    }

    fn check(&self, field: &'static str) -> Result<(), Refusal> {
        within(field, self.clearance_m, -1e3..=1e3)?;
        within(field, self.safe_s, 0.0..=1e3)?;
        within(field, self.edge_m, -1e4..=1e4)?;
        within(field, self.progress_m, -1e4..=1e4)?;
        known(field, self.verdict, Verdict::from_code)
    }
}

impl Step {
    /// Which driver drove.
    pub fn driver(&self) -> Driver {
        self.command.driver()
    }

    /// The reason.
    pub fn reason(&self) -> Option<Reason> {
        self.command.reason()
    }

    /// Whether the safety check vetoed the driver in charge.
    pub fn is_vetoed(&self) -> bool {
        matches!(self.reason(), Some(Reason::Vetoed | Reason::Unsafe))
    }

    /// Whether a person drove.
    pub fn is_taken_over(&self) -> bool {
        self.takeover_used == 1
    }

    /// Whether the command was decided too late, or the one before it was missing for that.
    pub fn is_late(&self) -> bool {
        self.lateness != Lateness::OnTime.code() || self.reason() == Some(Reason::Late)
    }

    /// What the process asked of the tick; an unknown code is read as a stop.
    pub fn intent(&self) -> Intent {
        Intent::from_code(self.intent).unwrap_or(Intent::Stop)
    }

    /// The stage of the policy; an unknown code is read as none.
    pub fn stage(&self) -> Stage {
        Stage::from_code(self.stage).unwrap_or(Stage::Unloaded)
    }
}

impl Default for Step {
    fn default() -> Self {
        Self {
            header: Header::default(),
            before: Before::default(),
            observation_entry: Entry::default(),
            plan_entry: Entry::default(),
            advice_entry: Entry::default(),
            takeover_entry: Entry::default(),
            plan: Plan::default(),
            advice: Advice::default(),
            takeover: Takeover::default(),
            expert: Proposal::default(),
            policy: Proposal::default(),
            expert_assessment: Assessment::default(),
            policy_assessment: Assessment::default(),
            shadow: ShadowProposal::default(),
            command: Command {
                header: Header::default(),
                steer: Action::BRAKE.steer,
                pedal: Action::BRAKE.pedal,
                driver: Driver::Brake.code(),
                reason: Reason::Blind.code(),
            },
            timings: Timings::default(),
            observation_age_ns: u64::MAX,
            plan_age_ns: u64::MAX,
            advice_age_ns: u64::MAX,
            weights_version: 0,
            weights_hash: 0,
            skipped: 0,
            refused: 0,
            refused_at_ports: 0,
            intent: Intent::Drive.code(),
            stage: Stage::Unloaded.code(),
            takeover_used: 0,
            lateness: Lateness::OnTime.code(),
            motion: [MOTION_AT_REST; MOTION_FEATURES],
            observation: Observation::default(),
        }
    }
}

impl Message for Step {
    header_accessors!();

    /// As its observation.
    fn used_bytes(&self) -> usize {
        core::mem::offset_of!(Self, observation) + self.observation.used_bytes()
    }

    fn check(&self) -> Result<(), Refusal> {
        self.before.check()?;
        self.observation_entry.check("observation_entry")?;
        self.plan_entry.check("plan_entry")?;
        self.advice_entry.check("advice_entry")?;
        self.takeover_entry.check("takeover_entry")?;
        self.observation.check()?;
        self.plan.check()?;
        self.advice.check()?;
        self.takeover.check()?;
        self.expert.check("expert")?;
        self.policy.check("policy")?;
        self.expert_assessment.check("expert_assessment")?;
        self.policy_assessment.check("policy_assessment")?;
        self.shadow.proposal.check("shadow.proposal")?;
        self.shadow.assessment.check("shadow.assessment")?;
        known("intent", self.intent, Intent::from_code)?;
        known("stage", self.stage, Stage::from_code)?;
        known("takeover_used", self.takeover_used, |code| {
            (code <= 1).then_some(code)
        })?;
        known("lateness", self.lateness, Lateness::from_code)?;
        for &velocity in &self.motion {
            within("motion", f64::from(velocity), 0.0..=1.0)?;
        }
        self.command.check()
    }
}
