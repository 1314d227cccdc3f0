use serde::{Deserialize, Serialize};

use super::{OutOfRange, in_range};

/// The runtime of the policy's net.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Backend {
    /// The native runtime where the net is a chain of layers, else ONNX Runtime.
    Auto,
    /// The native runtime; other nets are refused.
    Native,
    /// ONNX Runtime, for any net.
    Ort,
}

/// The policy: its weights, the runtime of its net, and when weights are rolled back.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Policy {
    /// Policy file to begin with; empty for none.
    pub file: String,
    /// The runtime of the net: auto, native or ort.
    pub backend: Backend,
    /// The library libonnxruntime.so or its folder; empty for the variable
    /// ORT_DYLIB_PATH, else the folder of ./vlaps setup onnxruntime.
    pub onnxruntime: String,
    /// In real time, if no file is named: begin with the weights that were in use when
    /// the last run of this name ended. Never in lockstep, where the same seed gives
    /// the same commands.
    pub resume: bool,
    /// Canary period of new weights, ticks: they propose in shadow mode and do not
    /// drive; 0 for none.
    pub shadow_ticks: u32,
    /// Ticks after the canary period in which the weights may still be rolled back.
    pub watch_ticks: u32,
    /// The weights are rolled back when the safety check vetoes a larger share than
    /// this of their proposals in these ticks.
    pub veto_rate_max: f64,
    /// The weights are rolled back when the mean change of the normalised action from
    /// tick to tick exceeds this, of steering or pedal.
    pub jump_max: f64,
    /// Largest difference between the answer to a probe and the one in the file.
    #[serde(skip)]
    pub tolerance: f64,
    /// A net is refused when half of its answers in the warm-up take longer than this,
    /// us. Not checked in lockstep.
    pub inference_max_us: f64,
    /// How long a tick waits for ONNX Runtime's answer, us; without an answer the
    /// policy has no proposal in this tick.
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
            shadow_ticks: 20,
            watch_ticks: 100,
            veto_rate_max: 0.5,
            // Actions drawn uniformly from their range change by 0.93 a tick, those of
            // the expert by less than 0.1; a net that changes by more than half the
            // range behaves more like noise than like a driver.
            jump_max: 0.5,
            tolerance: 1e-4,
            // A hundredth of the paper's period, and a hundred times what the native
            // runtime needs for 259-256-256-2.
            inference_max_us: 1000.0,
            ort_wait_us: 2000.0,
        }
    }
}

impl Policy {
    pub(super) fn check(&self) -> Result<(), OutOfRange> {
        in_range("policy.shadow_ticks", self.shadow_ticks, 0..=1_000_000)?;
        in_range("policy.watch_ticks", self.watch_ticks, 0..=1_000_000)?;
        in_range("policy.veto_rate_max", self.veto_rate_max, 0.0..=1.0)?;
        in_range("policy.jump_max", self.jump_max, 0.0..=2.0)?;
        in_range("policy.tolerance", self.tolerance, 0.0..=1.0)?;
        in_range("policy.inference_max_us", self.inference_max_us, 1.0..=1e6)?;
        in_range("policy.ort_wait_us", self.ort_wait_us, 1.0..=1e5)
    }
}
