//! The actors that this machine has for a learner on another one.

use std::io;
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::bail;
use rustls::{ClientConfig, ClientConnection, StreamOwned};
use supervisor::machine::signals::pause;
use supervisor::subcommand::say;

use super::actor::serve;
use super::envelope::Broken;
use super::tls::{Invitation, joining, listener_name};
use crate::stop::Stop;

/// How long a connection may take.
const CONNECT: Duration = Duration::from_secs(10);
/// A learner that asks for nothing for this time is gone: its longest block is shorter.
const SILENCE: Duration = Duration::from_secs(600);
/// Pause between two attempts.
const PAUSE: Duration = Duration::from_secs(1);
/// Interval of the checks for a stop request.
const LOOK: Duration = Duration::from_millis(100);
/// Attempts in a row until an actor gives up: a minute and more.
const ATTEMPTS_MAX: u32 = 60;
/// The same after a training: the next one of `--seeds` begins earlier.
const AFTER_MAX: u32 = 30;

/// A connection to the learner.
pub type Line = StreamOwned<ClientConnection, TcpStream>;

/// Connects to the learner of an invitation.
///
/// # Errors
/// When it does not listen, or is not the one that has invited.
pub fn connect(invitation: &Invitation, config: &Arc<ClientConfig>) -> io::Result<Line> {
    let mut last = io::Error::other("the address has no machine");
    for address in invitation.address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT) {
            Ok(stream) => return encrypt(stream, config),
            Err(error) => last = error,
        }
    }
    Err(last)
}

fn encrypt(stream: TcpStream, config: &Arc<ClientConfig>) -> io::Result<Line> {
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(SILENCE))?;
    stream.set_write_timeout(Some(SILENCE))?;
    let connection = ClientConnection::new(Arc::clone(config), listener_name());
    Ok(StreamOwned::new(
        connection.map_err(io::Error::other)?,
        stream,
    ))
}

/// Drives with so many worlds side by side until the learner has nothing left.
///
/// # Errors
/// When no learner was served, or a stop is requested.
pub fn drive(invitation: &Invitation, worlds: usize, stop: &Stop) -> anyhow::Result<()> {
    let config = joining(invitation)?;
    let served: Vec<_> = (0..worlds)
        .map(|world| {
            let (invitation, config, stop) = (invitation.clone(), config.clone(), stop.clone());
            std::thread::spawn(move || serve_all(&invitation, &config, (world, &stop)))
        })
        .collect();
    // A world that waits for the learner does not look for a stop request; the process ends it.
    while !served.iter().all(JoinHandle::is_finished) {
        if stop.is_asked() {
            bail!("stopped; the training gives its episodes to other actors");
        }
        pause(LOOK);
    }
    let (mut ended, mut refused) = (0, None);
    for thread in served {
        match thread.join() {
            Ok(Outcome::Served) => ended += 1,
            Ok(Outcome::TurnedAway(why)) => refused = Some(why),
            Ok(Outcome::NotServed) => {}
            // It has printed its own message.
            Err(_panic) => {}
        }
    }
    match (ended, refused) {
        (0, Some(why)) => bail!("{}: {why}", invitation.address),
        (0, None) => bail!("{}: no learner was served there", invitation.address),
        _ => Ok(()),
    }
}

/// How a world has ended.
enum Outcome {
    /// A learner had nothing left.
    Served,
    /// No learner had work to its end.
    NotServed,
    /// The learner does not take it; why.
    TurnedAway(String),
}

/// Serves one learner after the other.
fn serve_all(
    invitation: &Invitation,
    config: &Arc<ClientConfig>,
    (world, stop): (usize, &Stop),
) -> Outcome {
    let (mut has_ended, mut attempts, mut said) = (false, 0, String::new());
    while attempts < ATTEMPTS_MAX && !stop.is_asked() {
        let served = connect(invitation, config)
            .map_err(Broken::Gone)
            .and_then(|mut line| serve(&mut line, &invitation.peer));
        match served {
            Ok(()) => {
                if world == 0 {
                    say(format_args!(
                        "{}: nothing is left to drive; waits {AFTER_MAX} s for the next training",
                        invitation.address
                    ));
                }
                (has_ended, attempts) = (true, 0);
            }
            Err(Broken::TurnedAway(why)) => {
                return Outcome::TurnedAway(Broken::TurnedAway(why).to_string());
            }
            // Nothing listens any longer.
            Err(Broken::Gone(_)) if has_ended => {}
            Err(broken) => {
                let line = broken.to_string();
                // A reason is printed once, not with each attempt.
                if said != line {
                    say(format_args!(
                        "world {world}: {}: {line}",
                        invitation.address
                    ));
                    said = line;
                }
            }
        }
        if has_ended && attempts >= AFTER_MAX {
            break;
        }
        attempts += 1;
        pause(PAUSE);
    }
    match has_ended {
        true => Outcome::Served,
        false => Outcome::NotServed,
    }
}
