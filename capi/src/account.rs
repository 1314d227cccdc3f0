//! The account of one episode of a world: the commands that were obeyed, the way that
//! was driven, the contacts.

use sha2::{Digest, Sha256};
use shm_config::Instant;
use shm_config::message::{Command, Driver, Ego, Episode, Header, Outcome, Progress, Reason};
use vehicle::Action;

/// The account of the running episode.
#[derive(Clone)]
pub struct Account {
    seed: u64,
    /// Grid instants at which the world moved.
    ticks: u64,
    driven_m: f64,
    last: Option<(f64, f64)>,
    braked: u64,
    command_age_max_ns: u64,
    commands: Sha256,
    /// The progress that the world reported last.
    progress: Progress,
    crash_last_step: bool,
}

impl Account {
    /// Of an episode that begins.
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            ticks: 0,
            driven_m: 0.0,
            last: None,
            braked: 0,
            command_age_max_ns: 0,
            commands: Sha256::new(),
            progress: Progress::default(),
            crash_last_step: false,
        }
    }

    /// The action of a command, or the brake when no command is young enough. Both enter
    /// the digest.
    pub fn obey(&mut self, command: Option<&Command>, now: Instant) -> Action {
        let brake = Command {
            header: Header::default(),
            steer: Action::BRAKE.steer,
            pedal: Action::BRAKE.pedal,
            driver: Driver::Brake.code(),
            reason: Reason::Blind.code(),
        };
        self.ticks += 1;
        match command {
            Some(command) => {
                let age_ns = now.since_ns(command.header.taken());
                self.command_age_max_ns = self.command_age_max_ns.max(age_ns);
            }
            None => self.braked += 1,
        }
        let obeyed = command.unwrap_or(&brake);
        self.commands.update(obeyed.digest_bytes());
        obeyed.action()
    }

    /// Where the car is now, and what the world says of its progress.
    pub fn note(&mut self, ego: &Ego, progress: &Progress) {
        let here = (ego.x_world_m, ego.y_world_m);
        if let Some(before) = self.last.replace(here) {
            self.driven_m += (here.0 - before.0).hypot(here.1 - before.1);
        }
        self.crash_last_step = progress.contacts() > self.progress.contacts();
        self.progress = *progress;
    }

    /// The progress with what the library counts; the header is the caller's.
    pub fn progress(&self, outcome: Outcome, skipped: u64) -> Progress {
        Progress {
            seed: self.seed,
            episode_ticks: self.ticks,
            braked: self.braked,
            command_age_max_ns: self.command_age_max_ns,
            skipped,
            outcome: outcome.code(),
            ..self.progress
        }
    }

    /// The finished episode; the header is the caller's.
    pub fn episode(&self, outcome: Outcome, skipped: u64) -> Episode {
        Episode {
            header: Header::default(),
            seed: self.seed,
            ticks: self.ticks,
            completion: self.progress.completion,
            driven_m: self.driven_m,
            vehicle_contacts: self.progress.vehicle_contacts,
            object_contacts: self.progress.object_contacts,
            braked: self.braked,
            outcome: outcome.code(),
            crash_last_step: u32::from(self.crash_last_step),
            command_digest: self.commands.clone().finalize().into(),
            skipped,
        }
    }
}
