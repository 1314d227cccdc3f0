//! Unit costs of a fleet, and the flows of one car by the service table.
//!
//! A cost is measured (a page of `results/` has the command) or assumed; the tables say
//! which.

use shm_config::message::FEATURES;
use shm_config::services::{Delivery, Leaves, Rate, Row, SERVICES};

/// Ticks of a car and of each world of an actor, 1/s.
pub const RATE_HZ: f64 = 10.0;
/// Worlds of an actor.
pub const WORLDS: f64 = 64.0;
/// Transitions of one message of an actor: a block.
pub const BLOCK: f64 = 200.0;

/// A tick of one world of a batch of 64, s of a core (results/worlds.md).
pub const WORLD_TICK_S: f64 = 1.0 / 302_020.0;
/// An answer of the policy, s of a core (results/policy.md).
pub const INFERENCE_S: f64 = 6.3e-6;
/// An update of pvp with batch 1024, s of a core (results/policy.md); pvp makes one for each
/// step.
pub const UPDATE_S: f64 = 1.0 / 21.8;
/// One message of 56 bytes over Zenoh and TCP on one machine, s: the median, one after the
/// other (results/latency.md).
pub const MESSAGE_S: f64 = 70.7e-6;
/// Each byte of it, s: the difference of 56 and 4,936 bytes.
pub const BYTE_S: f64 = (74.17e-6 - 70.72e-6) / (4936.0 - 56.0);
/// A policy file, bytes (results/learning/ppl-50000.onnx).
pub const POLICY_BYTES: f64 = 535_251.0;
/// An answer of a judge, s: assumed, as the 1 s of `./vlaps bench latency --load gate`.
pub const ANSWER_S: f64 = 1.0;
/// Answers that one judge makes at the same time: assumed.
pub const ANSWERS_AT_ONCE: f64 = 16.0;
/// Questions of a car, 1/s: the paper's period of 10 s.
pub const QUESTIONS_HZ: f64 = 0.1;
/// Seconds between two new policies: assumed.
pub const POLICY_PERIOD_S: f64 = 10.0;
/// Network of a server, bytes/s: assumed, 10 Gbit/s.
pub const SERVER_BYTES_S: f64 = 1.25e9;
/// Uplink of a car, bytes/s: assumed, 20 Mbit/s.
pub const UPLINK_BYTES_S: f64 = 2.5e6;
/// Cores of a server: assumed.
pub const SERVER_CORES: f64 = 16.0;
/// Memory of a server, bytes: assumed.
pub const SERVER_MEMORY_BYTES: f64 = 128e9;

/// Bytes of a transition: features before and after, action, reward, three flags and
/// numbers of the sequence.
pub fn transition_bytes() -> f64 {
    (2 * FEATURES * size_of::<f32>() + 2 * size_of::<f32>() + 6 * size_of::<u32>()) as f64
}

/// A flow from one car to the server.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Flow {
    /// The service.
    pub service: &'static str,
    /// Messages of one car, 1/s.
    pub messages_per_s: f64,
    /// Bytes of a message.
    pub message_bytes: f64,
    /// Bytes that a reader keeps for messages that it has not read yet.
    pub queue_bytes: f64,
}

impl Flow {
    /// Bytes of one car, 1/s.
    pub fn bytes_per_s(&self) -> f64 {
        self.messages_per_s * self.message_bytes
    }
}

/// Time of a core that receives the messages of one car, s in each second.
pub fn receiving_s(flows: &[Flow]) -> f64 {
    let each = flows
        .iter()
        .map(|flow| flow.messages_per_s * (MESSAGE_S + flow.message_bytes * BYTE_S));
    each.sum()
}

/// Rates of the messages that an event causes, 1/s; the second is the direction.
const EVENTS: [(&str, f64, Direction); 6] = [
    ("frame_request", QUESTIONS_HZ, Direction::ToCar),
    ("frame", QUESTIONS_HZ, Direction::ToServer),
    ("foresight", QUESTIONS_HZ, Direction::ToServer),
    ("weights", 1.0 / POLICY_PERIOD_S, Direction::ToCar),
    ("policy_status", 1.0 / POLICY_PERIOD_S, Direction::ToServer),
    // An episode of 70 s, as in the README.
    ("episode", 1.0 / 70.0, Direction::ToServer),
];

#[derive(Clone, Copy, PartialEq)]
enum Direction {
    ToServer,
    ToCar,
}

/// The flows of one car to the server: what the service table lets leave the machine. Advice
/// and the learner's progress come from the server.
///
/// # Errors
/// The name of a service without a known rate.
pub fn flows() -> Result<Vec<Flow>, &'static str> {
    let leaving = SERVICES.iter().filter(|row| row.leaves != Leaves::No);
    let flows = leaving.filter_map(|row| match flow(row) {
        Ok(None) => None,
        Ok(Some(flow)) => Some(Ok(flow)),
        Err(name) => Some(Err(name)),
    });
    flows.collect()
}

fn flow(row: &'static Row) -> Result<Option<Flow>, &'static str> {
    let each_hz = match row.rate {
        _ if ["advice", "learning"].contains(&row.name) => return Ok(None),
        Rate::Tick(_) => RATE_HZ,
        Rate::Hz(hz) => hz,
        Rate::Event(_) => {
            let event = EVENTS.iter().find(|(name, ..)| *name == row.name);
            match event.ok_or(row.name)? {
                (_, _, Direction::ToCar) => return Ok(None),
                (_, hz, Direction::ToServer) => *hz,
            }
        }
    };
    // A family has a message of each process.
    let instances = match row.name.ends_with("/*") {
        true => row.producers.len(),
        false => 1,
    };
    let depth = match row.delivery {
        Delivery::Latest => 1,
        Delivery::Queue(depth) => depth,
    };
    let bytes = row.message.bytes as f64;
    Ok(Some(Flow {
        service: row.name,
        messages_per_s: each_hz * instances as f64,
        message_bytes: bytes,
        queue_bytes: (depth * instances) as f64 * bytes,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_service_that_leaves_the_machine_has_a_rate() {
        let flows = flows().expect("a rate for each");
        let of = |name: &str| flows.iter().find(|flow| flow.service == name).expect(name);
        // 10 steps a second; six processes send two histograms a second.
        let step = of("step");
        assert_eq!((step.messages_per_s, step.message_bytes), (10.0, 11872.0));
        assert_eq!(step.queue_bytes, 2048.0 * 11872.0);
        assert_eq!(of("timing/*").messages_per_s, 12.0);
        for own in [
            "observation",
            "plan",
            "command",
            "takeover",
            "roster",
            "advice",
            "weights",
        ] {
            assert!(flows.iter().all(|flow| flow.service != own), "{own}");
        }
    }

    #[test]
    fn a_transition_is_two_feature_vectors_and_little_more() {
        assert_eq!(transition_bytes(), 2104.0);
    }
}
