//! What the scripted controller is ordered to send.

use std::fmt;
use std::str::FromStr;

use shm_config::Instant;
use shm_config::message::{Command, Driver, Header, Reason};

/// How far a command from the future is ahead, ns; and how old one is that has expired.
/// No configuration admits either: an age limit is at most ten seconds.
const AWAY_NS: u64 = 60_000_000_000;
/// Episodes by which a command of another episode is ahead.
const EPISODES_AHEAD: u32 = 7;

/// What to send at each observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Order {
    /// Nothing.
    Silence,
    /// A valid command: steer and pedal, normalised.
    Drive(f64, f64),
    /// A command that no world may obey.
    Hostile(Hostile),
}

/// Why a world must not obey a command. Each of them has the pedal full down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Hostile {
    /// Its steering is not a number.
    Nan,
    /// Its pedal is 7.
    Range,
    /// It is a minute old.
    Stale,
    /// It is from the next minute.
    Future,
    /// It is of an episode that is not driven.
    Episode,
}

impl Hostile {
    pub(super) const ALL: [Self; 5] = [
        Self::Nan,
        Self::Range,
        Self::Stale,
        Self::Future,
        Self::Episode,
    ];

    fn word(self) -> &'static str {
        match self {
            Self::Nan => "nan",
            Self::Range => "range",
            Self::Stale => "stale",
            Self::Future => "future",
            Self::Episode => "episode",
        }
    }
}

impl Order {
    /// The command for the observation with this header; `None` for silence.
    pub(super) fn command(self, seen: Header, now: Instant) -> Option<Command> {
        let (steer, pedal) = match self {
            Self::Silence => return None,
            Self::Drive(steer, pedal) => (steer, pedal),
            Self::Hostile(_) => (0.0, 1.0),
        };
        let mut command = Command {
            header: Header {
                tick: seen.tick,
                taken_ns: now.0,
                episode: seen.episode,
                ..Header::default()
            },
            steer,
            pedal,
            driver: Driver::Expert.code(),
            reason: Reason::Configured.code(),
        };
        let header = &mut command.header;
        match self {
            Self::Silence | Self::Drive(..) => {}
            Self::Hostile(Hostile::Nan) => command.steer = f64::NAN,
            Self::Hostile(Hostile::Range) => command.pedal = 7.0,
            Self::Hostile(Hostile::Stale) => header.taken_ns = now.0.saturating_sub(AWAY_NS),
            Self::Hostile(Hostile::Future) => header.taken_ns = now.0 + AWAY_NS,
            Self::Hostile(Hostile::Episode) => {
                header.episode = seen.episode.wrapping_add(EPISODES_AHEAD);
            }
        }
        Some(command)
    }
}

/// As a line of the controller's input.
impl fmt::Display for Order {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Silence => f.write_str("silence"),
            Self::Drive(steer, pedal) => write!(f, "drive {steer} {pedal}"),
            Self::Hostile(kind) => f.write_str(kind.word()),
        }
    }
}

/// A line that is no order is silence: the car then brakes.
impl FromStr for Order {
    type Err = std::convert::Infallible;

    fn from_str(line: &str) -> Result<Self, Self::Err> {
        let words: Vec<&str> = line.split_whitespace().collect();
        Ok(match words.as_slice() {
            ["drive", steer, pedal] => match (steer.parse(), pedal.parse()) {
                (Ok(steer), Ok(pedal)) => Self::Drive(steer, pedal),
                _ => Self::Silence,
            },
            [word] => Hostile::ALL
                .into_iter()
                .find(|kind| kind.word() == *word)
                .map_or(Self::Silence, Self::Hostile),
            _ => Self::Silence,
        })
    }
}

#[cfg(test)]
mod tests {
    use shm_config::message::Message;

    use super::*;

    #[test]
    fn an_order_is_read_as_it_was_written() {
        let hostile = Hostile::ALL.map(Order::Hostile);
        for order in [Order::Silence, Order::Drive(-0.25, 1.0)]
            .into_iter()
            .chain(hostile)
        {
            assert_eq!(order.to_string().parse(), Ok(order));
        }
        for line in ["", "drive", "drive 1", "drive x 1", "faster"] {
            assert_eq!(line.parse(), Ok(Order::Silence), "{line}");
        }
    }

    #[test]
    fn every_hostile_command_is_one_that_a_world_refuses() {
        let now = Instant(100 * AWAY_NS);
        let seen = Header::default();
        let sent = |order: Order| order.command(seen, now).expect("a command");
        assert_eq!(sent(Order::Drive(0.5, 1.0)).admit(now, AWAY_NS / 2), Ok(()));
        for kind in Hostile::ALL {
            let command = sent(Order::Hostile(kind));
            let is_refused =
                command.admit(now, AWAY_NS / 2).is_err() || command.header.episode != seen.episode;
            assert!(is_refused, "{kind:?}");
        }
    }
}
