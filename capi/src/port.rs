//! Ports by the name of a service: what a language without these types opens.

use std::mem::MaybeUninit;

use shm_config::message::{
    Advice, Command, Episode, Foresight, FrameRequest, Learning, Message, Observation, Plan,
    PolicyStatus, Progress, Step, Takeover,
};
use shm_config::services::{self, Delivery, Process, Row, SERVICES, Service};
use shm_config::wire::{PUBLISHERS_MAX, Publisher, Subscriber, Wire};
use shm_config::word_list;

use crate::door::{Door, Enter};
use crate::failure::Failure;

word_list! {
    /// What a port does.
    pub enum Use {
        /// It reads the newest message.
        Newest = 0 "newest",
        /// It reads every message of a queue, in order.
        Every = 1 "every",
        /// It publishes.
        Write = 2 "write",
    }
}

/// The memory of the caller that a message is written to.
pub type Place<'a> = &'a mut [MaybeUninit<u8>];

/// A port of any service.
pub trait Port {
    /// The service that it publishes; `None` when it reads.
    fn publishes(&self) -> Option<&'static str>;

    /// Copies the newest admissible message; returns whether one came.
    ///
    /// # Errors
    /// When the place has another length, or the port does not read the newest message.
    fn newest(&mut self, entry: (&Wire, &Door), place: Place) -> Result<bool, Failure>;

    /// Copies the next admissible message of the queue; returns whether there was one.
    ///
    /// # Errors
    /// When the place has another length, or the port does not read.
    fn next(&mut self, entry: (&Wire, &Door), place: Place) -> Result<bool, Failure>;

    /// Checks the message and publishes it.
    ///
    /// # Errors
    /// When its length differs, its check refuses it, shared memory has no room, or the
    /// port does not publish.
    fn publish(&mut self, door: &Door, message: &[u8]) -> Result<(), Failure>;

    /// Connects to peers that came or came back.
    fn update_connections(&mut self);
}

/// Messages that are read past a refused one in a call, so that a hostile queue cannot
/// block its reader.
const REFUSED_MAX: usize = 64;

struct Reader<M: Message> {
    port: Subscriber<M>,
    service: &'static str,
    with: Use,
}

impl<M: Enter> Reader<M> {
    /// Copies the next message if it is admissible; `None` when there is none.
    fn take(
        &mut self,
        (wire, door): (&Wire, &Door),
        place: &mut [MaybeUninit<u8>],
    ) -> Option<bool> {
        let entered = self.port.visit(|message| {
            message.enter(door).map(|()| {
                place.write_copy_of_slice(message.as_bytes());
            })
        })?;
        if let Err(refusal) = &entered {
            wire.refuse(refusal);
        }
        Some(entered.is_ok())
    }
}

fn check_length<M>(service: &str, bytes: usize) -> Result<(), Failure> {
    match bytes == size_of::<M>() {
        true => Ok(()),
        false => Err(Failure::invalid(format!(
            "{service}: {bytes} bytes given, a message has {}",
            size_of::<M>()
        ))),
    }
}

impl<M: Enter> Port for Reader<M> {
    fn publishes(&self) -> Option<&'static str> {
        None
    }

    fn newest(&mut self, entry: (&Wire, &Door), place: Place) -> Result<bool, Failure> {
        check_length::<M>(self.service, place.len())?;
        // Of a queue, the messages before the newest would be lost.
        if self.with == Use::Every {
            let service = self.service;
            return Err(Failure::invalid(format!(
                "this port reads every {service}: vlaps_next reads the next one"
            )));
        }
        let mut came = false;
        // Two publishers exist while a dead one is replaced.
        for _ in 0..PUBLISHERS_MAX {
            match self.take(entry, place) {
                Some(entered) => came |= entered,
                None => break,
            }
        }
        Ok(came)
    }

    fn next(&mut self, entry: (&Wire, &Door), place: Place) -> Result<bool, Failure> {
        check_length::<M>(self.service, place.len())?;
        for _ in 0..REFUSED_MAX {
            match self.take(entry, place) {
                Some(false) => {}
                Some(true) => return Ok(true),
                None => return Ok(false),
            }
        }
        Ok(false)
    }

    fn publish(&mut self, _: &Door, _: &[u8]) -> Result<(), Failure> {
        let service = self.service;
        Err(Failure::invalid(format!("this port reads {service}")))
    }

    fn update_connections(&mut self) {
        self.port.update_connections();
    }
}

struct Writer<M: Message> {
    port: Publisher<M>,
    service: &'static str,
    workspace: Workspace<M>,
}

impl<M: Enter> Port for Writer<M> {
    fn publishes(&self) -> Option<&'static str> {
        Some(self.service)
    }

    fn newest(&mut self, _: (&Wire, &Door), _: Place) -> Result<bool, Failure> {
        let service = self.service;
        Err(Failure::invalid(format!("this port publishes {service}")))
    }

    fn next(&mut self, entry: (&Wire, &Door), place: Place) -> Result<bool, Failure> {
        self.newest(entry, place)
    }

    fn publish(&mut self, door: &Door, message: &[u8]) -> Result<(), Failure> {
        let message = self.workspace.admitted(self.service, door, message)?;
        match self.port.send(message) {
            true => Ok(()),
            false => Err(no_space(self.service)),
        }
    }

    fn update_connections(&mut self) {
        self.port.update_connections();
    }
}

/// The error of a publisher to which shared memory gives no sample.
pub fn no_space(service: &str) -> Failure {
    Failure {
        kind: crate::failure::Kind::Failed,
        text: format!("{service}: shared memory has no room; `./vlaps doctor` shows the space"),
    }
}

/// Room for a message of the caller. It is allocated for the first one; those of later
/// ticks are copied there.
pub struct Workspace<M>(Option<Box<M>>);

impl<M> Default for Workspace<M> {
    fn default() -> Self {
        Self(None)
    }
}

impl<M: Message> Workspace<M> {
    /// The message of these bytes, not yet checked.
    ///
    /// # Errors
    /// When their number is not the message's.
    pub fn read(&mut self, service: &str, bytes: &[u8]) -> Result<&mut M, Failure> {
        check_length::<M>(service, bytes.len())?;
        match &mut self.0 {
            Some(message) => {
                message.copy_from(bytes);
            }
            None => self.0 = M::from_bytes(bytes).map(Box::new),
        }
        let message = self.0.as_deref_mut();
        message.ok_or_else(|| Failure::invalid(format!("{service}: wrong length")))
    }
}

impl<M: Enter> Workspace<M> {
    /// A message of these bytes that has passed its check.
    fn admitted(&mut self, service: &str, door: &Door, bytes: &[u8]) -> Result<&mut M, Failure> {
        let message = self.read(service, bytes)?;
        match message.enter(door) {
            Ok(()) => Ok(message),
            Err(refusal) => Err(Failure::refused(service, &refusal)),
        }
    }
}

/// Opens a port, where the service's row names the process.
///
/// # Errors
/// For an unknown service, a row that does not name the process for this use or has no
/// queue to read every message of, and when shared memory refuses.
pub fn open(
    wire: &Wire,
    process: Process,
    name: &str,
    with: Use,
) -> Result<Box<dyn Port>, Failure> {
    let row = row_of(name)?;
    let (is_named, does) = match with {
        Use::Newest | Use::Every => (row.is_consumed_by(process), "reads"),
        Use::Write => (row.is_produced_by(process), "publishes"),
    };
    if !is_named {
        return Err(Failure::invalid(format!(
            "the row of {name} in docs/services.md does not say that the {process} {does} it"
        )));
    }
    if with == Use::Every && row.delivery == Delivery::Latest {
        return Err(Failure::invalid(format!(
            "{name} has no queue, only its newest message can be read"
        )));
    }
    match with {
        Use::Write => writer(wire, name),
        Use::Newest | Use::Every => reader(wire, name, with),
    }
}

fn row_of(name: &str) -> Result<&'static Row, Failure> {
    let found = SERVICES.iter().find(|row| row.instances.contains(&name));
    found.ok_or_else(|| {
        let names: Vec<_> = SERVICES.iter().map(|row| row.name).collect();
        Failure::invalid(format!(
            "no service '{name}'; there are {}",
            names.join(", ")
        ))
    })
}

fn unopened(name: &str) -> Failure {
    Failure::invalid(match name {
        "weights" => "weights are a file: offer it with `./vlaps swap FILE.onnx`".into(),
        _ => format!("{name} has no port of its own here: the library reads or publishes it"),
    })
}

fn read_with<M: Enter>(
    wire: &Wire,
    service: Service<M>,
    with: Use,
) -> Result<Box<dyn Port>, Failure> {
    let port = match with {
        Use::Every => wire.subscriber(service)?,
        _ => wire.latest(service)?,
    };
    let service = service.name;
    Ok(Box::new(Reader {
        port,
        service,
        with,
    }))
}

fn write_to<M: Enter>(wire: &Wire, service: Service<M>) -> Result<Box<dyn Port>, Failure> {
    let port = wire.publisher(service)?;
    let service = service.name;
    Ok(Box::new(Writer {
        port,
        service,
        workspace: Workspace::default(),
    }))
}

/// A frame has two megabytes, which do not belong on the stack of a caller: it is read
/// and not written here.
macro_rules! tables {
    (both { $($name:ident: $message:ty,)+ } read { $($large:ident,)+ }) => {
        fn reader(wire: &Wire, name: &str, with: Use) -> Result<Box<dyn Port>, Failure> {
            $( if name == services::$name.name { return read_with(wire, services::$name, with); } )+
            $( if name == services::$large.name { return read_with(wire, services::$large, with); } )+
            Err(unopened(name))
        }

        fn writer(wire: &Wire, name: &str) -> Result<Box<dyn Port>, Failure> {
            $( if name == services::$name.name { return write_to(wire, services::$name); } )+
            Err(unopened(name))
        }

        /// Checks a message as its reader will.
        ///
        /// # Errors
        /// When the length or the check refuses it, or the service has no port here.
        pub fn admit(door: &Door, name: &str, message: &[u8]) -> Result<(), Failure> {
            row_of(name)?;
            $( if name == services::$name.name {
                let mut workspace = Workspace::<$message>::default();
                return workspace.admitted(name, door, message).map(|_| ());
            } )+
            Err(unopened(name))
        }
    };
}

tables! {
    both {
        OBSERVATION: Observation,
        PLAN: Plan,
        COMMAND: Command,
        STEP: Step,
        ADVICE: Advice,
        TAKEOVER: Takeover,
        FRAME_REQUEST: FrameRequest,
        FORESIGHT: Foresight,
        LEARNING: Learning,
        POLICY_STATUS: PolicyStatus,
        PROGRESS: Progress,
        EPISODE: Episode,
    }
    read {
        FRAME,
    }
}

#[cfg(test)]
mod tests {
    use shm_config::layout::Layout;

    use super::*;

    #[test]
    fn only_the_first_message_of_a_workspace_is_allocated() {
        let sent = [0.25, 0.5].map(|steer| {
            let mut observation = Observation::default();
            observation.ego.steer = steer;
            observation
        });
        let mut workspace = Workspace::<Observation>::default();
        let mut read = |observation: &Observation| {
            let seen = workspace.read("observation", observation.as_bytes());
            seen.expect("its length").ego.steer
        };
        let [first, later] = sent.each_ref().map(|observation| {
            let mut steer = 0.0;
            let counted = allocation_counter::measure(|| steer = read(observation));
            (steer, counted.count_total)
        });
        assert_eq!((first, later), ((0.25, 1), (0.5, 0)));
        let short = workspace.read("observation", &[0; 3]);
        assert!(short.is_err(), "another length is refused");
    }
}
