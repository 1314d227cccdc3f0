use serde::{Deserialize, Serialize};

use super::{OutOfRange, in_range};

/// Who runs the policy's net.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Backend {
    /// The native runtime where the net is a chain of layers, else ONNX Runtime.
    Auto,
    /// The native runtime; other nets are refused.
    Native,
    /// ONNX Runtime, whatever the net is.
    Ort,
}

/// The policy: which weights, who runs them, and when they are given up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Policy {
    /// Policy file to begin with; empty for none.
    pub file: String,
    /// Who runs the net: auto, native or ort.
    pub backend: Backend,
    /// The library libonnxruntime.so or its folder; empty for ORT_DYLIB_PATH,
    /// else the folder of ./vlaps setup onnxruntime.
    pub onnxruntime: String,
    /// In real time: begin with the weights that were good when the run of this
    /// name went down, if no file is named. Never in lockstep, where the same
    /// seed gives the same commands.
    pub resume: bool,
    /// Ticks that new weights only propose in shadow, before they may drive; 0
    /// for none.
    pub probation_ticks: u32,
    /// Ticks after that in which they may still be rolled back to those before.
    pub watch_ticks: u32,
    /// Share of these ticks with the judge's veto on their proposals over which
    /// they are rolled back.
    pub veto_rate_max: f64,
    /// Mean change of the normalised action from tick to tick over which they
    /// are rolled back, of steering or pedal, whichever changes more.
    pub jump_max: f64,
    /// How far the answer to a probe may be from the one in the file.
    #[serde(skip)]
    pub tolerance: f64,
    /// Nets that take longer to answer are refused, us; half of the answers in
    /// the warm-up must be quicker. Not looked at in lockstep.
    pub inference_max_us: f64,
    /// How long a tick waits for ONNX Runtime's answer, us; without one, the
    /// policy has no proposal in it.
    #[serde(skip)]
    pub ort_wait_us: f64,
}

impl Default for Policy {
    fn default() -> Self {
        Self {
            file: String::new(),
            backend: Backend::Auto,
            onnxruntime: String::new(),
            resume: true,
            // Two seconds at the paper's 10 Hz, about 10 m of road.
            probation_ticks: 20,
            watch_ticks: 100,
            veto_rate_max: 0.5,
            // Actions drawn evenly from their whole range change by 0.93 a tick,
            // the expert's by less than 0.1; a net that jumps by more than half
            // of what it may is nearer to dice than to driving.
            jump_max: 0.5,
            tolerance: 1e-4,
            // A hundredth of the paper's period, a hundred times what the native
            // runtime needs for 259-256-256-2.
            inference_max_us: 1000.0,
            ort_wait_us: 2000.0,
        }
    }
}

impl Policy {
    pub(super) fn check(&self) -> Result<(), OutOfRange> {
        in_range(
            "policy.probation_ticks",
            self.probation_ticks,
            0..=1_000_000,
        )?;
        in_range("policy.watch_ticks", self.watch_ticks, 0..=1_000_000)?;
        in_range("policy.veto_rate_max", self.veto_rate_max, 0.0..=1.0)?;
        in_range("policy.jump_max", self.jump_max, 0.0..=2.0)?;
        in_range("policy.tolerance", self.tolerance, 0.0..=1.0)?;
        in_range("policy.inference_max_us", self.inference_max_us, 1.0..=1e6)?;
        in_range("policy.ort_wait_us", self.ort_wait_us, 1.0..=1e5)
    }
}
