//! The account of the commands that moved a car in one episode.

use sha2::{Digest, Sha256};
use shm_config::Instant;
use shm_config::message::{Command, Driver, Header, Reason};
use vehicle::Action;

/// Which commands were applied, how old they were, and how often there was none.
#[derive(Clone, Default)]
pub struct CommandAccount {
    braked: u64,
    /// The car was braked in the present tick because no command was there.
    is_braked: bool,
    age_max_ns: u64,
    commands: Sha256,
}

impl CommandAccount {
    /// The action of a command, or the brake when no command is young enough. The bits
    /// of the action enter the digest in both cases.
    pub fn obey(&mut self, command: Option<&Command>, now: Instant) -> Action {
        let brake = Command {
            header: Header::default(),
            steer: Action::BRAKE.steer,
            pedal: Action::BRAKE.pedal,
            driver: Driver::Brake.code(),
            reason: Reason::Blind.code(),
        };
        match command {
            Some(command) => {
                let age_ns = now.since_ns(command.header.taken());
                self.age_max_ns = self.age_max_ns.max(age_ns);
            }
            None => self.is_braked = true,
        }
        let obeyed = command.unwrap_or(&brake);
        self.commands.update(obeyed.digest_bytes());
        obeyed.action()
    }

    /// Ends a tick of the episode: it counts as braked if any of its actions was the
    /// brake for want of a command.
    pub fn end_tick(&mut self) {
        self.braked += u64::from(self.is_braked);
        self.is_braked = false;
    }

    /// Ticks braked for want of a command.
    pub fn braked(&self) -> u64 {
        self.braked
    }

    /// Greatest age of an applied command, ns.
    pub fn age_max_ns(&self) -> u64 {
        self.age_max_ns
    }

    /// SHA-256 over the bits of the actions so far.
    pub fn digest(&self) -> [u8; 32] {
        self.commands.clone().finalize().into()
    }
}
