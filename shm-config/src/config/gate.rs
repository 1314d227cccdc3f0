use serde::{Deserialize, Serialize};

use super::{GateMode, OutOfRange, Run, in_range};

/// The greatest `gate.in_flight`.
pub const IN_FLIGHT_MAX: u32 = 16;

/// When a judge is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum When {
    /// Every `period_s` only, as in Sec. 4.2.
    Period,
    /// Every `period_s`, and when it matters: the proposals differ, or one of them
    /// comes near something.
    Matters,
}

/// The slow judge behind a distilled one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PassTo {
    /// The vision-language model of section `vlm`.
    Vlm,
    /// Exact geometry, as with `rules`.
    Rules,
}

/// The gate process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Gate {
    /// What decides which driver acts.
    pub mode: GateMode,
    /// When the judge is asked: `period`, or also when it `matters`.
    pub when: When,
    /// Period of questions, s: `T_vlm` of Sec. 4.2.
    pub period_s: f64,
    /// Least time between two questions, s, also when a step matters.
    pub spacing_s: f64,
    /// A step matters when its proposals differ by more than this in steering or pedal.
    pub differ: f64,
    /// A step matters when a proposal comes nearer than this to something, m.
    pub clearance_m: f64,
    /// How long advice is valid, s, from the observation it is about. A little over one
    /// period, so that timely answers leave no gap.
    pub hold_s: f64,
    /// How long an answer labels the recorded steps, s, from its question on, if no
    /// later question's answer covers them; 0 for `period_s`.
    pub label_s: f64,
    /// After the expert takes over from the policy, the policy drives again after this
    /// time at the earliest, s. The expert takes over at once.
    pub dwell_s: f64,
    /// The policy also needs this many consecutive answers that prefer it.
    pub confirmations: u32,
    /// The most questions that may be in flight to a slow judge.
    pub in_flight: u32,
    /// For `takeover`: the expert drives when the policy's steering differs by more than
    /// this from its own. PVP4Real's human has 0.38 for actions with more spread.
    pub takeover_steer: f64,
    /// The same for the pedal; PVP4Real's human has 1.28.
    pub takeover_pedal: f64,
    /// For `distilled`: the file that `./vlaps judge distil` has written.
    pub distilled: String,
    /// For `distilled`: the judge that is asked what the net does not know: `vlm` or
    /// `rules`.
    pub pass_to: PassTo,
    /// For `distilled`: share of the questions that the net has answered which the slow
    /// judge is asked, too, to count how often both agree. Its answer decides nothing. Its
    /// question counts for gate.in_flight and vlm.per_minute_max, and is left out while the
    /// slow judge has another one.
    pub audit: f64,
    /// Ask the world of each question what would follow if either proposal were held, for
    /// the record alone, also where the judge sees no picture. The built-in world knows
    /// it.
    pub foresight: bool,
    /// For `replay`: the folder with the questions of a recorded run.
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
            // With each question asked twice, this is vlm.per_minute_max.
            spacing_s: 2.0,
            // Half of what a lane change takes, and a tenth of the pedal's range.
            differ: 0.2,
            clearance_m: 0.5,
            hold_s: 12.0,
            label_s: 0.0,
            // The change of the command at a hand-over takes about half a second.
            dwell_s: 2.0,
            confirmations: 1,
            in_flight: 2,
            // results/learning.md compares other thresholds.
            takeover_steer: 0.1,
            takeover_pedal: 0.5,
            distilled: String::new(),
            pass_to: PassTo::Vlm,
            // One question in twenty costs a twentieth of the slow judge alone.
            audit: 0.05,
            foresight: false,
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
        in_range("gate.takeover_steer", self.takeover_steer, 0.0..=2.0)?;
        in_range("gate.takeover_pedal", self.takeover_pedal, 0.0..=2.0)?;
        in_range("gate.audit", self.audit, 0.0..=1.0)?;
        in_range("gate.confirmations", self.confirmations, 1..=100)?;
        in_range("gate.in_flight", self.in_flight, 1..=IN_FLIGHT_MAX)
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
            (GateMode::Replay, _) if self.foresight => refuse(
                "gate.foresight",
                "true".into(),
                "false when gate.mode is replay: the recorded answers are repeated, and nothing is \
                 recorded",
            ),
            (GateMode::Distilled, _) if self.distilled.is_empty() => refuse(
                "gate.distilled",
                "\"\"".into(),
                "the file that ./vlaps judge distil has written when gate.mode is distilled",
            ),
            _ => Ok(()),
        }
    }

    /// Whether the mode has a process that publishes advice.
    pub fn has_process(&self) -> bool {
        self.mode.is_advised()
    }

    /// Whether the mode asks a model, which takes time.
    pub fn asks_model(&self) -> bool {
        match self.mode {
            GateMode::Vlm | GateMode::Paper => true,
            GateMode::Distilled => self.pass_to == PassTo::Vlm,
            GateMode::Rules | GateMode::Replay => false,
            GateMode::Expert | GateMode::Policy | GateMode::Human | GateMode::Takeover => false,
        }
    }

    /// Whether the gate process asks the world for pictures, or for what would follow.
    pub fn asks_world(&self) -> bool {
        self.asks_model() || (self.foresight && self.has_process())
    }

    /// How long an answer labels the recorded steps, ns.
    pub fn label_ns(&self) -> u64 {
        let label_s = match self.label_s > 0.0 {
            true => self.label_s,
            false => self.period_s,
        };
        (label_s * 1e9) as u64
    }
}

/// Faults injected into the judge, to measure how much of them driving and learning
/// tolerate. Only experiments set them.
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

    /// Whether a fault is configured.
    pub fn is_active(&self) -> bool {
        self.noise > 0.0 || self.abstention > 0.0 || self.delay_s > 0.0
    }
}
