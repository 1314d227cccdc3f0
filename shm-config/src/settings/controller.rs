use serde::{Deserialize, Serialize};

use super::{OutOfRange, in_range};

/// The PD controller of Sec. 4.1.2; every default is the paper's.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Controller {
    /// Steering gain on the heading error.
    pub steer_kp: f64,
    /// Steering gain on the rate of the heading error.
    pub steer_kd: f64,
    /// Pedal gain on the speed error.
    pub pedal_kp: f64,
    /// Pedal gain on the rate of the speed error.
    pub pedal_kd: f64,
    /// Distance to the waypoint that is steered at, m: `d_LA` of Sec. 4.1.1.
    pub lookahead_m: f64,
    /// Limit of the steering's rate of change during a hand-over, from the last command
    /// to the new driver's, 1/s; 0 for no limit. A veto, a takeover and the brake act
    /// at once.
    pub handover_steer_per_s: f64,
    /// The same limit for the pedal, 1/s.
    pub handover_pedal_per_s: f64,
}

impl Default for Controller {
    fn default() -> Self {
        Self {
            steer_kp: 2.0,
            steer_kd: 0.001,
            pedal_kp: 0.1,
            pedal_kd: 0.05,
            lookahead_m: 2.0,
            // From lock to lock in a second, from no to full pedal in 0.2 s.
            handover_steer_per_s: 2.0,
            handover_pedal_per_s: 5.0,
        }
    }
}

impl Controller {
    /// Checks every number.
    ///
    /// # Errors
    /// The first number that is not finite or outside its limits.
    pub fn check(&self) -> Result<(), OutOfRange> {
        in_range("controller.steer_kp", self.steer_kp, 0.0..=100.0)?;
        in_range("controller.steer_kd", self.steer_kd, 0.0..=100.0)?;
        in_range("controller.pedal_kp", self.pedal_kp, 0.0..=100.0)?;
        in_range("controller.pedal_kd", self.pedal_kd, 0.0..=100.0)?;
        in_range("controller.lookahead_m", self.lookahead_m, 0.1..=30.0)?;
        for (key, per_s) in [
            ("controller.handover_steer_per_s", self.handover_steer_per_s),
            ("controller.handover_pedal_per_s", self.handover_pedal_per_s),
        ] {
            in_range(key, per_s, 0.0..=1000.0)?;
        }
        Ok(())
    }
}

/// The safety check in the tick: rollouts of the bicycle model against lidar returns
/// and road.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SafetyLimits {
    /// Horizon of the rollouts, s: the paper's picture shows 1.5 s.
    pub horizon_s: f64,
    /// Integration step, s.
    #[serde(skip)]
    pub step_s: f64,
    /// Lidar returns nearer to the footprint than this count as contact, m.
    pub margin_m: f64,
    /// The car has left the road when its centre is this far beyond the edge, m.
    #[serde(skip)]
    pub edge_margin_m: f64,
    /// Margin of the veto, s: a contact or exit is vetoed when it is due sooner than
    /// the time to stop plus this.
    pub reaction_s: f64,
}

impl Default for SafetyLimits {
    fn default() -> Self {
        Self {
            horizon_s: 1.5,
            step_s: 0.1,
            // Three grid cells: the returns are exact, the rollout is not.
            margin_m: 0.15,
            edge_margin_m: 0.0,
            // Two periods: this tick's command is in force during the next tick too.
            reaction_s: 0.2,
        }
    }
}

impl SafetyLimits {
    /// Checks every number.
    ///
    /// # Errors
    /// The first number that is not finite or outside its limits.
    pub fn check(&self) -> Result<(), OutOfRange> {
        in_range("safety.horizon_s", self.horizon_s, 0.1..=5.0)?;
        in_range("safety.step_s", self.step_s, 0.02..=1.5)?;
        in_range("safety.margin_m", self.margin_m, 0.0..=5.0)?;
        in_range("safety.edge_margin_m", self.edge_margin_m, -5.0..=5.0)?;
        in_range("safety.reaction_s", self.reaction_s, 0.0..=5.0)
    }
}
