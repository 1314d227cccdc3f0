//! The learner's side of one connection, on a thread of its own: asks for one episode after
//! the other and checks what comes.
//!
//! One episode is on its way at a time, and the thread waits until the learner has taken it:
//! what an actor makes the learner hold is bounded, and an actor that is faster waits.

use std::io::{Read, Write};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender};

use rustls::pki_types::CertificateDer;
use shm_config::message::Step;

use super::actor::build;
use super::envelope::{Broken, Kind, Outgoing, Rejection, receive};
use super::message::{
    Assignment, EpisodeKey, ended, hello, put_assignment, put_policy, put_text, steps, text,
};
use super::order::SeatNumber;
use super::tls::is_of_peer;

/// A policy for the actors.
#[derive(Clone)]
pub struct OfferedPolicy {
    /// Steps that it has learnt from; not 0.
    pub version: u64,
    /// Its file.
    pub file: Arc<[u8]>,
}

/// An episode, with the policy that drives it.
pub struct Asked {
    /// The episode.
    pub assignment: Assignment,
    /// The policy; none before the first block is learnt.
    pub policy: Option<OfferedPolicy>,
}

/// What a connection tells the learner.
pub enum SeatEvent {
    /// An actor of the same build and of this name is ready.
    Ready(SeatNumber, String),
    /// It has driven an episode.
    Whole(SeatNumber, EpisodeKey, Vec<Box<Step>>),
    /// The connection has ended.
    Gone(SeatNumber, Broken),
}

/// Who may be at the other end.
pub enum Guest {
    /// The actor of this name, which this process has started.
    Own(String),
    /// The actor that has this certificate.
    Certified(CertificateDer<'static>),
}

impl Guest {
    /// The actor's name; `None` if the identity is not its own.
    fn name(&self, identity: &str) -> Option<String> {
        match self {
            Guest::Own(name) => identity.is_empty().then(|| name.clone()),
            Guest::Certified(certificate) => {
                let begin = identity.get(..NAME_DIGITS)?;
                is_of_peer(certificate, identity).then(|| format!("actor {begin}"))
            }
        }
    }
}

/// Tells an actor why it may not join.
///
/// # Errors
/// When it is gone.
pub fn turn_away(line: &mut (impl Write + ?Sized), why: Rejection) -> Result<(), Broken> {
    let mut out = Outgoing::default();
    put_text(&mut out, why.word(), Kind::Refused.bytes_max());
    out.send(Kind::Refused, line)
}

/// Digits of an identity in an actor's name: those of eight actors differ with a probability
/// of 1 - 1e-8.
const NAME_DIGITS: usize = 8;

/// The learner's end of a connection.
pub struct Seat {
    /// Its number.
    pub number: SeatNumber,
    /// Who may be there.
    pub guest: Guest,
    /// Tells the learner.
    pub events: SyncSender<SeatEvent>,
    /// What the learner asks for; it ends when nothing is left.
    pub orders: Receiver<Asked>,
}

/// The stop of the learner, which receives no events any more.
struct Stopped;

impl Seat {
    /// Serves the connection to its end.
    pub fn serve(&self, line: &mut (impl Read + Write), configuration: &str) {
        if let Err(broken) = self.talk(line, configuration) {
            // The learner may have ended.
            let _ = self.events.send(SeatEvent::Gone(self.number, broken));
        }
    }

    fn tell(&self, event: SeatEvent) -> Result<(), Stopped> {
        self.events.send(event).map_err(|_| Stopped)
    }

    fn talk(&self, line: &mut (impl Read + Write), configuration: &str) -> Result<(), Broken> {
        let (mut out, mut body) = (Outgoing::default(), Vec::new());
        receive(line, &[Kind::Hello], &mut body)?;
        let (theirs, identity) = hello(&body)?;
        let name = match self.guest.name(identity) {
            _ if theirs != build() => Err(Rejection::Build),
            None => Err(Rejection::Identity),
            Some(name) => Ok(name),
        };
        let name = match name {
            Ok(name) => name,
            Err(why) => {
                // It may be gone.
                let _ = turn_away(line, why);
                return Err(why.into());
            }
        };
        put_text(&mut out, configuration, Kind::Welcome.bytes_max());
        out.send(Kind::Welcome, line)?;
        if self.tell(SeatEvent::Ready(self.number, name)).is_err() {
            return Ok(());
        }
        let mut version = 0;
        let mut incoming = Incoming::default();
        while let Ok(Asked { assignment, policy }) = self.orders.recv() {
            if let Some(policy) = policy.filter(|policy| policy.version != version) {
                version = policy.version;
                put_policy(&mut out, version, &policy.file);
                out.send(Kind::Policy, line)?;
            }
            put_assignment(&mut out, &assignment);
            out.send(Kind::Drive, line)?;
            loop {
                let (key, steps) = incoming.episode(line, assignment.ticks_max)?;
                if self
                    .tell(SeatEvent::Whole(self.number, key, steps))
                    .is_err()
                {
                    return Ok(());
                }
                // Another one is an answer to an earlier question.
                if key == assignment.key {
                    break;
                }
            }
        }
        out.begin();
        out.send(Kind::Finish, line)
    }
}

/// An episode that is being received.
#[derive(Default)]
struct Incoming {
    key: Option<EpisodeKey>,
    steps: Vec<Box<Step>>,
    body: Vec<u8>,
    scratch: Vec<u8>,
}

impl Incoming {
    /// Receives a whole episode of so many steps at most.
    fn episode(
        &mut self,
        line: &mut (impl Read + ?Sized),
        ticks_max: u32,
    ) -> Result<(EpisodeKey, Vec<Box<Step>>), Broken> {
        loop {
            let wanted = [Kind::Steps, Kind::Ended, Kind::Failed];
            match receive(line, &wanted, &mut self.body)? {
                Kind::Steps => self.add(ticks_max)?,
                Kind::Ended => {
                    let (key, ticks) = ended(&self.body)?;
                    if self.key.take() != Some(key) || ticks as usize != self.steps.len() {
                        return Err(Rejection::Sequence.into());
                    }
                    return Ok((key, std::mem::take(&mut self.steps)));
                }
                _ => return Err(Broken::Failed(text(&self.body)?.to_string())),
            }
        }
    }

    /// Adds the steps of a frame, which begin an episode or follow those before.
    fn add(&mut self, ticks_max: u32) -> Result<(), Rejection> {
        let received = steps(&self.body, &mut self.scratch)?;
        if received.first == 0 && self.key.is_none() {
            self.key = Some(received.key);
        }
        let is_next = received.first as usize == self.steps.len();
        if self.key != Some(received.key) || !is_next {
            return Err(Rejection::Sequence);
        }
        self.steps.extend(received.steps);
        match self.steps.len() <= ticks_max as usize {
            true => Ok(()),
            false => Err(Rejection::Unasked),
        }
    }
}
