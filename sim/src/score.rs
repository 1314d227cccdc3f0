//! The account of one episode: the commands that were applied, contacts, and the
//! outcome.

use robot::account::CommandAccount;
use shm_config::Instant;
use shm_config::message::{Command, Episode, Header, Outcome, Progress};
use vehicle::Action;

use crate::world::{StepOutcome, World};

/// The account of the running episode.
#[derive(Clone)]
pub struct Score {
    seed: u64,
    vehicle_contacts: u64,
    object_contacts: u64,
    crash_last_step: bool,
    commands: CommandAccount,
}

impl Score {
    /// An account with zero counts.
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            vehicle_contacts: 0,
            object_contacts: 0,
            crash_last_step: false,
            commands: CommandAccount::default(),
        }
    }

    /// The action of a command, or the brake when no command is young enough. The bits
    /// of the action enter the digest in both cases.
    pub fn obey(&mut self, command: Option<&Command>, now: Instant) -> Action {
        self.commands.obey(command, now)
    }

    /// Counts the contacts of a tick.
    pub fn count(&mut self, step: &StepOutcome) {
        self.commands.end_tick();
        self.vehicle_contacts += u64::from(step.touch.vehicle);
        self.object_contacts += u64::from(step.touch.object);
        // MetaDrive's flag counts sidewalks too: IDM's published crash share is the
        // share of maps where it touches one.
        self.crash_last_step = step.touch.vehicle || step.touch.object || step.on_sidewalk;
    }

    /// SHA-256 over the bits of the commands so far.
    pub fn digest(&self) -> [u8; 32] {
        self.commands.digest()
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
            braked: self.commands.braked(),
            outcome: outcome.code(),
            crash_last_step: u32::from(self.crash_last_step),
            command_digest: self.digest(),
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
            braked: self.commands.braked(),
            command_age_max_ns: self.commands.age_max_ns(),
            skipped: 0,
            outcome: outcome.code(),
            reserved: 0,
        }
    }
}
