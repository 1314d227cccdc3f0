//! A publisher with the right to write that publishes wrong messages.

use clap::ValueEnum;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::Rng;
use shm_config::Instant;
use shm_config::message::{Command, Message, Plan, Step};
use shm_config::services::TAKEOVER;
use shm_config::services::{ADVICE, COMMAND, Delivery, OBSERVATION, PLAN, Process, STEP, Service};
use shm_config::wire::{Publisher, Wire, WireError};

/// Messages of a flood.
const FLOOD: u32 = 2000;
/// Messages of any other lie, one after the other.
const REPEATS: u32 = 20;

/// What is wrong with a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Lie {
    /// A number is NaN.
    NotANumber,
    /// A number is infinite, or beyond all limits.
    Huge,
    /// Numbers, counts and codes of random bits.
    Garbage,
    /// Taken long ago.
    Stale,
    /// Taken in the future.
    Future,
    /// In order, but of a tick at the end of all counting.
    LastTick,
    /// Thousands of broken messages at once.
    Flood,
    /// Another layout under the same name.
    Version,
}

/// A service that can be lied on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Stream {
    /// From the world.
    Observation,
    /// From the planner.
    Plan,
    /// From the controller.
    Command,
    /// From the controller.
    Step,
    /// From the gate.
    Advice,
    /// From the supervisor.
    Takeover,
}

/// One lie: what, where.
#[derive(Debug, Clone, Copy)]
pub struct Told {
    /// What is wrong.
    pub lie: Lie,
    /// Where it is published.
    pub stream: Stream,
}

impl std::fmt::Display for Told {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let word = |value: clap::builder::PossibleValue| value.get_name().to_string();
        let lie = self.lie.to_possible_value().map_or(String::new(), word);
        let stream = self.stream.to_possible_value().map_or(String::new(), word);
        write!(f, "{lie} on {stream}")
    }
}

impl Told {
    /// Draws one.
    pub fn draw(dice: &mut Xoshiro256PlusPlus) -> Self {
        let mut pick = |count: usize| (dice.next_u64() % count as u64) as usize;
        let (lies, streams) = (Lie::value_variants(), Stream::value_variants());
        Self {
            lie: lies[pick(lies.len())],
            stream: streams[pick(streams.len())],
        }
    }

    /// Tells it. What is not wrong in the message is that of the newest step.
    /// Returns whether it was sent: a message of another layout cannot be.
    ///
    /// # Errors
    /// When shared memory refuses.
    pub fn tell(
        self,
        wire: &Wire,
        (step, now): (&Step, Instant),
        dice: &mut Xoshiro256PlusPlus,
    ) -> Result<bool, WireError> {
        if self.lie == Lie::Version {
            return self.tell_other_layout(wire);
        }
        let mut liar = Liar {
            wire,
            lie: self.lie,
            now,
            dice,
        };
        match self.stream {
            Stream::Observation => liar.tell(OBSERVATION, step.observation, |o, number, code| {
                o.ego.speed_mps = number;
                o.ranges_m[code as usize % 240] = number as f32;
                o.beam_count = code;
                o.scheduled_ns = u64::from(code) << 30;
            }),
            Stream::Plan => liar.tell(PLAN, step.plan, |p, number, code| {
                p.waypoints[0].y_body_m = number;
                p.cost_m = number;
                p.waypoint_count = code;
                p.action_count = code;
                p.outcome = code;
            }),
            Stream::Command => liar.tell(COMMAND, step.command, |c, number, code| {
                c.steer = number;
                c.pedal = number;
                c.driver = code;
            }),
            Stream::Step => liar.tell(STEP, *step, |s, number, code| {
                s.command.steer = number;
                s.observation.ego.speed_mps = number;
                s.plan.waypoint_count = code;
                s.skipped = u64::MAX;
            }),
            Stream::Advice => liar.tell(ADVICE, step.advice, |a, _, code| {
                a.preference = code;
                a.judge = code;
                a.label = code;
                a.answers = u64::MAX;
            }),
            Stream::Takeover => liar.tell(TAKEOVER, step.takeover, |t, number, code| {
                t.steer = number;
                t.active = code;
            }),
        }?;
        Ok(true)
    }

    fn tell_other_layout(self, wire: &Wire) -> Result<bool, WireError> {
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

struct Liar<'a> {
    wire: &'a Wire,
    lie: Lie,
    now: Instant,
    dice: &'a mut Xoshiro256PlusPlus,
}

impl Liar<'_> {
    /// Publishes spoilt copies of a message; `spoil` puts a number and a code into
    /// fields that mean something.
    fn tell<M: Message>(
        &mut self,
        service: Service<M>,
        mut message: M,
        spoil: impl Fn(&mut M, f64, u32),
    ) -> Result<(), WireError> {
        let mut port: Publisher<M> = self.wire.publisher(service)?;
        port.update_connections();
        let count = match self.lie {
            Lie::Flood => FLOOD,
            _ => REPEATS,
        };
        message.header_mut().taken_ns = self.now.0;
        for _ in 0..count {
            let huge = [f64::INFINITY, -1e300, 1e9, -1.5][self.dice.next_u64() as usize % 4];
            let bits = self.dice.next_u64();
            match self.lie {
                Lie::NotANumber | Lie::Flood => spoil(&mut message, f64::NAN, u32::MAX),
                Lie::Huge => spoil(&mut message, huge, 513),
                Lie::Garbage => spoil(&mut message, f64::from_bits(bits), bits as u32),
                Lie::Stale => message.header_mut().taken_ns = self.now.0 / 2,
                Lie::Future => message.header_mut().taken_ns = self.now.0 + 3_600_000_000_000,
                Lie::LastTick => message.header_mut().tick = u64::MAX - 1,
                Lie::Version => {}
            }
            port.send(&mut message);
        }
        Ok(())
    }
}
