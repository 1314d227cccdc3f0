//! One subscriber for each recorded service: for the recorder, and for a program beside the
//! run that passes the messages on.

use shm_config::Message;
use shm_config::message::Header;
use shm_config::services::{
    ADVICE, COMMAND, EPISODE, FAULT, FORESIGHT, FRAME, HEALTH, LEARNING, OBSERVATION, PLAN,
    POLICY_STATUS, PROGRESS, ROSTER, Row, STEP, Service, TAKEOVER, TIMING, WEIGHTS,
};
use shm_config::wire::{Subscriber, Wire, WireError};

use crate::Channel;

/// Messages of one service that are read in one turn, so that a producer faster than this
/// loop cannot keep it there.
const TURN_MAX: usize = 8192;

/// Takes the header and the memory of a message, and how many bytes of it are used.
pub type Take<'a> = &'a mut dyn FnMut(&Header, &[u8], usize);

/// The reading end of one service.
pub trait Tap {
    /// Its channel.
    fn channel(&self) -> &Channel;
    /// Its row of the service table.
    fn row(&self) -> &Row;
    /// Connects to new publishers.
    fn update_connections(&mut self);
    /// Gives every message that waits.
    fn drain(&mut self, take: Take<'_>);
}

struct Typed<M: Message> {
    channel: Channel,
    row: Row,
    port: Subscriber<M>,
}

impl<M: Message> Tap for Typed<M> {
    fn channel(&self) -> &Channel {
        &self.channel
    }

    fn row(&self) -> &Row {
        &self.row
    }

    fn update_connections(&mut self) {
        self.port.update_connections();
    }

    fn drain(&mut self, take: Take<'_>) {
        for _ in 0..TURN_MAX {
            let seen = self.port.visit(|message| {
                take(message.header(), message.as_bytes(), message.used_bytes());
            });
            if seen.is_none() {
                return;
            }
        }
    }
}

/// Opens the reading ends of all recorded services, in the order of the service table: that
/// of a tick.
///
/// # Errors
/// As [`Wire::subscriber`].
pub fn open(wire: &Wire) -> Result<Vec<Box<dyn Tap>>, WireError> {
    let mut taps: Vec<Box<dyn Tap>> = Vec::new();
    macro_rules! open {
        ($($service:ident),+) => { $( open_row(wire, $service, &mut taps)?; )+ };
    }
    open!(
        OBSERVATION,
        PLAN,
        COMMAND,
        STEP,
        ADVICE,
        TAKEOVER,
        FRAME,
        FORESIGHT,
        WEIGHTS,
        LEARNING,
        POLICY_STATUS,
        PROGRESS,
        EPISODE,
        HEALTH,
        TIMING,
        ROSTER,
        FAULT
    );
    let opened: Vec<_> = taps.iter().map(|tap| tap.channel().clone()).collect();
    debug_assert_eq!(opened, Channel::recorded());
    Ok(taps)
}

fn open_row<M: Message>(
    wire: &Wire,
    service: Service<M>,
    taps: &mut Vec<Box<dyn Tap>>,
) -> Result<(), WireError> {
    let row = service.row;
    let mut open_one = |service: Service<M>| {
        let port = wire.every(service)?;
        let channel = Channel::of(&row, service.name);
        taps.push(Box::new(Typed { channel, row, port }) as Box<dyn Tap>);
        Ok::<_, WireError>(())
    };
    match row.instances.len() > 1 {
        true => row
            .producers
            .iter()
            .try_for_each(|process| open_one(service.instance(*process))),
        false => open_one(service),
    }
}

/// Every recorded row is opened: the list above is the table's.
#[cfg(test)]
mod tests {
    use shm_config::services::{Recorded, SERVICES};

    #[test]
    fn the_list_is_that_of_the_table() {
        let source = include_str!("taps.rs");
        let list = source
            .split("open!(")
            .nth(1)
            .and_then(|rest| rest.split(')').next());
        let named: Vec<_> = list
            .expect("the list")
            .split(',')
            .map(|name| name.trim().to_lowercase())
            .collect();
        let rows = SERVICES.iter().filter(|row| row.recorded != Recorded::No);
        let rows: Vec<_> = rows
            .map(|row| row.name.trim_end_matches("/*").to_string())
            .collect();
        assert_eq!(named, rows);
    }
}
