//! The actor's side of a connection: drives what the learner asks for, and keeps nothing
//! between two episodes.

use std::io::{Read, Write};
use std::ops::ControlFlow;

use shm_config::config::from_toml;
use shm_config::text::printable;

use super::drive::Episodes;
use super::envelope::{Broken, Kind, Outgoing, Rejection, STEPS_MAX, receive};
use super::message::{
    Assignment, EpisodeKey, StepsBody, assignment, policy, put_ended, put_hello, put_text, text,
};

/// The build, as both sides compare it: another build may drive otherwise.
pub fn build() -> String {
    let commit = std::env::var("VLAPS_COMMIT").unwrap_or_default();
    format!("{} {commit}", env!("CARGO_PKG_VERSION"))
}

/// What the actor has from the learner.
struct Given {
    episodes: Episodes,
    version: u64,
    policy: Vec<u8>,
}

/// Drives episodes until the learner has none left; `identity` is that of the invitation,
/// and empty within a machine.
///
/// # Errors
/// When the learner is gone, sends a frame that is refused, or asks for what this build
/// cannot drive.
pub fn serve(line: &mut (impl Read + Write), identity: &str) -> Result<(), Broken> {
    let (mut out, mut body) = (Outgoing::default(), Vec::new());
    put_hello(&mut out, &build(), identity);
    out.send(Kind::Hello, line)?;
    if receive(line, &[Kind::Welcome, Kind::Refused], &mut body)? == Kind::Refused {
        return Err(Broken::TurnedAway(printable(text(&body)?).into_owned()));
    }
    let config = from_toml(text(&body)?, "the learner's configuration");
    let config = config.map_err(|error| Broken::Failed(error.to_string()))?;
    let episodes = Episodes::new(&config).map_err(|error| Broken::Failed(error.to_string()))?;
    let mut given = Given {
        episodes,
        version: 0,
        policy: Vec::new(),
    };
    loop {
        let wanted = [Kind::Policy, Kind::Drive, Kind::Finish];
        match receive(line, &wanted, &mut body)? {
            Kind::Policy => {
                let (version, file) = policy(&body)?;
                (given.version, given.policy) = (version, file.to_vec());
            }
            Kind::Drive => {
                let asked = assignment(&body)?;
                if let Err(error) = given.drive(&asked, &mut out, line) {
                    if let Broken::Failed(text) = &error {
                        put_text(&mut out, text, Kind::Failed.bytes_max());
                        out.send(Kind::Failed, line)?;
                    }
                    return Err(error);
                }
            }
            _ => return Ok(()),
        }
    }
}

impl Given {
    /// Drives an episode and sends its steps.
    fn drive(
        &self,
        asked: &Assignment,
        out: &mut Outgoing,
        line: &mut impl Write,
    ) -> Result<(), Broken> {
        let policy = match asked.version {
            0 => None,
            version if version == self.version => {
                let built = self.episodes.policy(version, &self.policy);
                Some(built.map_err(|error| Broken::Failed(error.to_string()))?)
            }
            _ => return Err(Rejection::Content.into()),
        };
        let mut sending = SentSteps::new(asked.key, out);
        let mut broken = None;
        let driven = self
            .episodes
            .drive(asked.key, asked.ticks_max, policy, |step| {
                match sending.add(step, line) {
                    Ok(()) => ControlFlow::Continue(()),
                    Err(error) => {
                        broken = Some(error);
                        ControlFlow::Break(())
                    }
                }
            });
        if let Some(error) = broken {
            return Err(error);
        }
        let ticks = driven.map_err(|error| Broken::Failed(format!("{error:#}")))?;
        sending.end(ticks, line)
    }
}

/// Steps on their way to the learner, several in a frame.
pub struct SentSteps<'a> {
    key: EpisodeKey,
    out: &'a mut Outgoing,
    /// Ticks that were sent, and steps in the frame that is being filled.
    sent: u32,
    filled: u32,
}

impl<'a> SentSteps<'a> {
    /// Of an episode.
    pub fn new(key: EpisodeKey, out: &'a mut Outgoing) -> SentSteps<'a> {
        SentSteps {
            key,
            out,
            sent: 0,
            filled: 0,
        }
    }

    /// Adds a step; sends the frame when it is full.
    ///
    /// # Errors
    /// When the learner is gone.
    pub fn add(
        &mut self,
        step: &shm_config::message::Step,
        line: &mut (impl Write + ?Sized),
    ) -> Result<(), Broken> {
        let mut body = match self.filled {
            0 => StepsBody::begin(self.out, self.key, self.sent),
            _ => StepsBody::of(self.out),
        };
        body.add(step);
        self.filled = body.count();
        match self.filled as usize == STEPS_MAX {
            true => self.flush(line),
            false => Ok(()),
        }
    }

    fn flush(&mut self, line: &mut (impl Write + ?Sized)) -> Result<(), Broken> {
        self.sent += self.filled;
        self.filled = 0;
        self.out.send(Kind::Steps, line)
    }

    /// Sends the rest, and the end of the episode.
    ///
    /// # Errors
    /// When the learner is gone.
    pub fn end(mut self, ticks: u32, line: &mut (impl Write + ?Sized)) -> Result<(), Broken> {
        if self.filled > 0 {
            self.flush(line)?;
        }
        put_ended(self.out, self.key, ticks);
        self.out.send(Kind::Ended, line)
    }
}
