//! A publisher of malformed messages that has write access to the run's services.

use clap::ValueEnum;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::Rng;
use shm_config::Instant;
use shm_config::message::{Command, Message, Plan, Step};
use shm_config::services::TAKEOVER;
use shm_config::services::{ADVICE, COMMAND, Delivery, OBSERVATION, PLAN, Process, STEP, Service};
use shm_config::wire::{Publisher, Wire, WireError};

/// Number of messages of a flood.
const FLOOD: u32 = 2000;
/// Number of messages of any other defect.
const REPEATS: u32 = 20;

/// The defect of a malformed message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Defect {
    /// A number is NaN.
    NotANumber,
    /// A number is infinite or beyond every limit.
    Huge,
    /// Numbers, counts and codes are random bits.
    Garbage,
    /// The timestamp is far in the past.
    Stale,
    /// The timestamp is in the future.
    Future,
    /// The message is valid, but its tick is the largest number.
    LastTick,
    /// Thousands of broken messages at once.
    Flood,
    /// The service has another layout of the same name.
    Version,
}

/// A service that the malformed messages are published on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Stream {
    /// Published by the world.
    Observation,
    /// Published by the planner.
    Plan,
    /// Published by the controller.
    Command,
    /// Published by the controller.
    Step,
    /// Published by the gate.
    Advice,
    /// Published by the supervisor.
    Takeover,
}

/// A defect and the service on which it is published.
#[derive(Debug, Clone, Copy)]
pub struct Malformed {
    /// The defect.
    pub defect: Defect,
    /// The service.
    pub stream: Stream,
}

impl std::fmt::Display for Malformed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let word = |value: clap::builder::PossibleValue| value.get_name().to_string();
        let defect = self.defect.to_possible_value().map_or(String::new(), word);
        let stream = self.stream.to_possible_value().map_or(String::new(), word);
        write!(f, "{defect} on {stream}")
    }
}

impl Malformed {
    /// Draws one at random.
    pub fn draw(dice: &mut Xoshiro256PlusPlus) -> Self {
        let mut pick = |count: usize| (dice.next_u64() % count as u64) as usize;
        let (lies, streams) = (Defect::value_variants(), Stream::value_variants());
        Self {
            defect: lies[pick(lies.len())],
            stream: streams[pick(streams.len())],
        }
    }

    /// Publishes it. All other fields of the message are those of the newest step. Returns
    /// whether it was sent: a message of another layout cannot be.
    ///
    /// # Errors
    /// If shared memory refuses.
    pub fn publish(
        self,
        wire: &Wire,
        (step, now): (&Step, Instant),
        dice: &mut Xoshiro256PlusPlus,
    ) -> Result<bool, WireError> {
        if self.defect == Defect::Version {
            return self.publish_other_layout(wire);
        }
        let mut forger = Forger {
            wire,
            defect: self.defect,
            now,
            dice,
        };
        match self.stream {
            Stream::Observation => {
                forger.publish(OBSERVATION, step.observation, |o, number, code| {
                    o.ego.speed_mps = number;
                    o.ranges_m[code as usize % 240] = number as f32;
                    o.beam_count = code;
                    o.scheduled_ns = u64::from(code) << 30;
                })
            }
            Stream::Plan => forger.publish(PLAN, step.plan, |p, number, code| {
                p.waypoints[0].y_body_m = number;
                p.cost_m = number;
                p.waypoint_count = code;
                p.action_count = code;
                p.outcome = code;
            }),
            Stream::Command => forger.publish(COMMAND, step.command, |c, number, code| {
                c.steer = number;
                c.pedal = number;
                c.driver = code;
            }),
            Stream::Step => forger.publish(STEP, *step, |s, number, code| {
                s.command.steer = number;
                s.observation.ego.speed_mps = number;
                s.plan.waypoint_count = code;
                s.skipped = u64::MAX;
            }),
            Stream::Advice => forger.publish(ADVICE, step.advice, |a, _, code| {
                a.preference = code;
                a.judge = code;
                a.label = code;
                a.answers = u64::MAX;
            }),
            Stream::Takeover => forger.publish(TAKEOVER, step.takeover, |t, number, code| {
                t.steer = number;
                t.active = code;
            }),
        }?;
        Ok(true)
    }

    fn publish_other_layout(self, wire: &Wire) -> Result<bool, WireError> {
        let refused = match self.stream {
            Stream::Observation => other::<Command>(wire, OBSERVATION.name),
            Stream::Plan => other::<Command>(wire, PLAN.name),
            Stream::Command => other::<Plan>(wire, COMMAND.name),
            Stream::Step => other::<Command>(wire, STEP.name),
            Stream::Advice => other::<Command>(wire, ADVICE.name),
            Stream::Takeover => other::<Plan>(wire, TAKEOVER.name),
        };
        match refused {
            Err(WireError::Layout { .. }) => Ok(false),
            Err(error) => Err(error),
            Ok(()) => Ok(true),
        }
    }
}

fn other<M: Message>(wire: &Wire, name: &'static str) -> Result<(), WireError> {
    let service = Service::<M>::custom(name, Process::Learner, &[], Delivery::Latest);
    wire.publisher(service).map(drop)
}

struct Forger<'a> {
    wire: &'a Wire,
    defect: Defect,
    now: Instant,
    dice: &'a mut Xoshiro256PlusPlus,
}

impl Forger<'_> {
    /// Publishes malformed copies of a message; `spoil` puts a number and a code into
    /// fields of the message.
    fn publish<M: Message>(
        &mut self,
        service: Service<M>,
        mut message: M,
        spoil: impl Fn(&mut M, f64, u32),
    ) -> Result<(), WireError> {
        let mut port: Publisher<M> = self.wire.publisher(service)?;
        port.update_connections();
        let count = match self.defect {
            Defect::Flood => FLOOD,
            _ => REPEATS,
        };
        message.header_mut().taken_ns = self.now.0;
        for _ in 0..count {
            let huge = [f64::INFINITY, -1e300, 1e9, -1.5][self.dice.next_u64() as usize % 4];
            let bits = self.dice.next_u64();
            match self.defect {
                Defect::NotANumber | Defect::Flood => spoil(&mut message, f64::NAN, u32::MAX),
                Defect::Huge => spoil(&mut message, huge, 2049),
                Defect::Garbage => spoil(&mut message, f64::from_bits(bits), bits as u32),
                Defect::Stale => message.header_mut().taken_ns = self.now.0 / 2,
                Defect::Future => message.header_mut().taken_ns = self.now.0 + 3_600_000_000_000,
                Defect::LastTick => message.header_mut().tick = u64::MAX - 1,
                Defect::Version => {}
            }
            port.send(&mut message);
        }
        Ok(())
    }
}
