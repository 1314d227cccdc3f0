//! The account of one episode: the commands that were applied, contacts, and the
//! outcome.

use sha2::{Digest, Sha256};
use shm_config::Instant;
use shm_config::message::{Command, Driver, Episode, Header, Outcome, Progress, Reason};
use vehicle::Action;

use crate::world::{StepOutcome, World};

/// The account of the running episode.
#[derive(Clone)]
pub struct Score {
    seed: u64,
    vehicle_contacts: u64,
    object_contacts: u64,
    crash_last_step: bool,
    braked: u64,
    /// The car was braked in the present tick because no command was there.
    is_braked: bool,
    command_age_max_ns: u64,
    commands: Sha256,
}

impl Score {
    /// An account with zero counts.
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            vehicle_contacts: 0,
            object_contacts: 0,
            crash_last_step: false,
            braked: 0,
            is_braked: false,
            command_age_max_ns: 0,
            commands: Sha256::new(),
        }
    }

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
                self.command_age_max_ns = self.command_age_max_ns.max(age_ns);
            }
            None => self.is_braked = true,
        }
        let obeyed = command.unwrap_or(&brake);
        self.commands.update(obeyed.digest_bytes());
        obeyed.action()
    }

    /// Counts the contacts of a tick.
    pub fn count(&mut self, step: &StepOutcome) {
        self.braked += u64::from(self.is_braked);
        self.is_braked = false;
        self.vehicle_contacts += u64::from(step.touch.vehicle);
        self.object_contacts += u64::from(step.touch.object);
        // MetaDrive's flag counts sidewalks too: IDM's published crash share is the
        // share of maps where it touches one.
        self.crash_last_step = step.touch.vehicle || step.touch.object || step.on_sidewalk;
    }

    /// The finished episode, without its header.
    pub fn episode(&self, world: &World, outcome: Outcome) -> Episode {
        Episode {
            header: Header::default(),
            seed: self.seed,
            ticks: world.ticks(),
            completion: world.completion(),
            driven_m: world.driven_m(),
            vehicle_contacts: self.vehicle_contacts,
            object_contacts: self.object_contacts,
            braked: self.braked,
            outcome: outcome.code(),
            crash_last_step: u32::from(self.crash_last_step),
            command_digest: self.commands.clone().finalize().into(),
            skipped: 0,
        }
    }

    /// The progress of the episode, without its header.
    pub fn progress(&self, world: &World, outcome: Outcome) -> Progress {
        Progress {
            header: Header::default(),
            seed: self.seed,
            completion: world.completion(),
            route_m: world.route_m(),
            speed_mps: world.speed_mps(),
            episode_ticks: world.ticks(),
            vehicle_contacts: self.vehicle_contacts,
            object_contacts: self.object_contacts,
            braked: self.braked,
            command_age_max_ns: self.command_age_max_ns,
            skipped: 0,
            outcome: outcome.code(),
            reserved: 0,
        }
    }
}
