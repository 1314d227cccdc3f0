//! Drivers for tests and examples.
#![allow(dead_code)]

use shm_config::message::Observation;
use vehicle::Action;

/// Follows its lane at about 8 m/s and ignores other bodies.
pub fn keep_lane(observation: &Observation) -> Action {
    let road = &observation.road;
    Action {
        steer: -(0.8 * road.heading_rad + 0.12 * road.offset_m),
        pedal: 0.3 * (8.0 - observation.ego.speed_mps),
    }
    .clamped()
}

/// Random-looking numbers in [-1, 1] (SplitMix64).
pub struct Noise(pub u64);

impl Noise {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    /// An action anywhere within its limits.
    pub fn action(&mut self) -> Action {
        Action {
            steer: self.unit(),
            pedal: self.unit(),
        }
    }
}
