use serde::{Deserialize, Serialize};

use super::{GateMode, OutOfRange, Run, in_range};

/// When a judge is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum When {
    /// Every `period_s` only, as in Sec. 4.2.
    Period,
    /// Every `period_s`, and when it matters: the proposals differ, or one of
    /// them comes near something.
    Matters,
}

/// The gate process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Gate {
    /// What decides which driver acts.
    pub mode: GateMode,
    /// When the judge is asked: `period`, or also when it `matters`.
    pub when: When,
    /// Time from question to question, s: `T_vlm` of Sec. 4.2.
    pub period_s: f64,
    /// Least time between two questions, s, however much it matters.
    pub spacing_s: f64,
    /// Proposals that differ by more than this in steering or pedal matter.
    pub differ: f64,
    /// A proposal that comes nearer than this to something matters, m.
    pub clearance_m: f64,
    /// How long advice holds, s, from the observation it is about. A little over
    /// one period, so that an answer in time leaves no gap.
    pub hold_s: f64,
    /// How long an answer is the label of what is learnt, s, from its question,
    /// if no later question's answer covers it; 0 for `period_s`.
    pub label_s: f64,
    /// The policy gets the wheel back at the earliest this long after it lost
    /// it, s. The expert gets it at once.
    pub dwell_s: f64,
    /// And only after this many answers in a row that prefer it.
    pub confirmations: u32,
    /// Questions that may be on their way to a slow judge at once.
    pub in_flight: u32,
    /// For `replay`: the folder of a recorded run's questions.
    pub recording: String,
    /// Keep every question in `runs/NAME/judge`, for `./vlaps judge audit`.
    pub record: bool,
}

impl Default for Gate {
    fn default() -> Self {
        Self {
            mode: GateMode::Rules,
            when: When::Matters,
            period_s: 10.0,
            // Asked twice, that is vlm.per_minute_max.
            spacing_s: 2.0,
            // Half of what a lane change takes, a tenth of the pedal's way.
            differ: 0.2,
            clearance_m: 0.5,
            hold_s: 12.0,
            label_s: 0.0,
            // A hand-over takes about half a second to be eased.
            dwell_s: 2.0,
            confirmations: 1,
            in_flight: 2,
            recording: String::new(),
            record: true,
        }
    }
}

impl Gate {
    pub(super) fn check(&self, run: &Run) -> Result<(), OutOfRange> {
        self.check_mode(run)?;
        in_range("gate.period_s", self.period_s, 0.001..=3600.0)?;
        in_range("gate.spacing_s", self.spacing_s, 0.0..=3600.0)?;
        in_range("gate.differ", self.differ, 0.0..=2.0)?;
        in_range("gate.clearance_m", self.clearance_m, 0.0..=50.0)?;
        in_range("gate.hold_s", self.hold_s, 0.001..=7200.0)?;
        in_range("gate.label_s", self.label_s, 0.0..=7200.0)?;
        in_range("gate.dwell_s", self.dwell_s, 0.0..=3600.0)?;
        in_range("gate.confirmations", self.confirmations, 1..=100)?;
        in_range("gate.in_flight", self.in_flight, 1..=16)
    }

    fn check_mode(&self, run: &Run) -> Result<(), OutOfRange> {
        let refuse = |key: &str, value: String, expected: &str| {
            Err(OutOfRange {
                key: key.into(),
                value,
                expected: expected.into(),
            })
        };
        match (self.mode, run.is_lockstep()) {
            (GateMode::Human, true) => refuse(
                "gate.mode",
                "human".into(),
                "another one in lockstep: a person needs real time; drop --lockstep, or set \
                 run.clock = \"real_time\"",
            ),
            (GateMode::Paper, false) => refuse(
                "gate.mode",
                "paper".into(),
                "vlm in real time: the paper's judge pauses the world, which is possible with \
                 --lockstep only",
            ),
            (GateMode::Replay, _) if self.recording.is_empty() => refuse(
                "gate.recording",
                "\"\"".into(),
                "the folder runs/NAME/judge of a recorded run when gate.mode is replay",
            ),
            _ => Ok(()),
        }
    }

    /// The mode has a process that gives advice.
    pub fn has_process(&self) -> bool {
        self.mode.is_advised()
    }

    /// The mode asks a model, which takes its time.
    pub fn asks_model(&self) -> bool {
        match self.mode {
            GateMode::Vlm | GateMode::Paper => true,
            GateMode::Rules | GateMode::Replay => false,
            GateMode::Expert | GateMode::Policy | GateMode::Human => false,
        }
    }

    /// How long an answer is the label of what is learnt, ns.
    pub fn label_ns(&self) -> u64 {
        let label_s = match self.label_s > 0.0 {
            true => self.label_s,
            false => self.period_s,
        };
        (label_s * 1e9) as u64
    }
}

/// Faults injected into the judge, to measure how much of them driving and learning
/// tolerate. Experiments alone set them; by default the judge runs without them.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FaultyJudge {
    /// Share of the preferences that are inverted (label noise).
    pub noise: f64,
    /// Share of the preferences that are withheld.
    pub abstention: f64,
    /// Delay of an answer after its question, s.
    pub delay_s: f64,
    /// Seed of the draws: which answers are inverted or withheld.
    pub seed: u64,
}

impl FaultyJudge {
    pub(super) fn check(&self) -> Result<(), OutOfRange> {
        in_range("faulty_judge.noise", self.noise, 0.0..=1.0)?;
        in_range("faulty_judge.abstention", self.abstention, 0.0..=1.0)?;
        in_range("faulty_judge.delay_s", self.delay_s, 0.0..=600.0)
    }

    /// Some fault is configured.
    pub fn is_active(&self) -> bool {
        self.noise > 0.0 || self.abstention > 0.0 || self.delay_s > 0.0
    }
}
