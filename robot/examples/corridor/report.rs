//! What the machines of the examples `serial` and `can` report, and how an observation is
//! made of it: they drive in a straight corridor six metres wide.

use robot::{Checkpoint, Ego, Observation, Road, scan};
use serde::{Deserialize, Serialize};

/// Half of the corridor's width, m.
const HALF_WIDTH_M: f64 = 3.0;
/// Places of the two checkpoints ahead, m.
const AHEAD_M: [f64; 2] = [20.0, 40.0];

/// What the machine senses.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Odometry: place, m, and heading, rad, counter-clockwise.
    pub x_m: f32,
    pub y_m: f32,
    pub heading_rad: f32,
    /// Speed along the heading, m/s.
    pub speed_mps: f32,
    /// Turning rate, rad/s, counter-clockwise.
    pub yaw_rate_radps: f32,
    /// Ranges of the lidar, m: one of each beam of the section `[scanner]`, in their order.
    /// NaN or infinity is a beam without a return. None at all is a lidar that is dead.
    pub ranges_m: Vec<f32>,
}

impl Report {
    /// Fills an observation.
    pub fn fill(&self, observation: &mut Observation) {
        let (y_m, heading_rad) = (f64::from(self.y_m), f64::from(self.heading_rad));
        observation.ego = Ego {
            x_world_m: self.x_m.into(),
            y_world_m: y_m,
            heading_world_rad: heading_rad,
            speed_mps: self.speed_mps.into(),
            yaw_rate_radps: self.yaw_rate_radps.into(),
            ..observation.ego
        };
        observation.road = Road {
            left_m: HALF_WIDTH_M - y_m,
            right_m: HALF_WIDTH_M + y_m,
            heading_rad,
            offset_m: y_m,
            lane_width_m: 0.0,
        };
        let (sin, cos) = heading_rad.sin_cos();
        observation.checkpoints = AHEAD_M.map(|ahead_m| Checkpoint {
            x_body_m: ahead_m * cos - y_m * sin,
            y_body_m: -ahead_m * sin - y_m * cos,
            ..Checkpoint::default()
        });
        let fan = observation.fan();
        scan(observation, |direction_rad| {
            let beam = fan.beam_at(direction_rad).round() as usize;
            let range_m = self.ranges_m.get(beam);
            range_m.map_or(f64::NAN, |range_m| f64::from(*range_m))
        });
    }
}
