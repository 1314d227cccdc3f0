use super::{Config, GateMode, PromptPreset, Rollout, When};

impl Config {
    /// The configuration with everything that its mode implies written out. Loading a
    /// configuration applies it, and no other code resolves a mode, so the saved
    /// configuration is the one that every process uses.
    ///
    /// `gate.mode = "paper"` asks each question once, every `T_vlm`, names expert and
    /// policy, shows one step of 1.5 s, applies an answer at once (Sec. 4.2 and 8.5),
    /// and hands over without limiting the change of the command.
    pub(super) fn with_preset(mut self) -> Self {
        if self.gate.mode != GateMode::Paper {
            return self;
        }
        self.gate.when = When::Period;
        self.gate.dwell_s = 0.0;
        self.gate.confirmations = 1;
        self.vlm.ask_twice = false;
        self.vlm.rollout = Rollout::Paper;
        self.vlm.horizon_s = 1.5;
        self.vlm.prompt = PromptPreset::Paper;
        self.controller.handover_steer_per_s = 0.0;
        self.controller.handover_pedal_per_s = 0.0;
        self
    }
}
