//! The account of one episode of a world: the commands that were obeyed, the way that
//! was driven, the contacts.

use robot::account::CommandAccount;
use robot::plant::Moment;
use shm_config::message::{Command, Ego, Episode, Header, Outcome, Progress};
use vehicle::Action;

/// The account of the running episode.
#[derive(Clone)]
pub struct Account {
    seed: u64,
    /// The run's newest tick that is in the account.
    tick: Option<u64>,
    /// Ticks in which the world moved.
    ticks: u64,
    driven_m: f64,
    last: Option<(f64, f64)>,
    commands: CommandAccount,
    /// The progress that the world reported last.
    progress: Progress,
    crash_last_step: bool,
}

impl Account {
    /// Of an episode that begins.
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            tick: None,
            ticks: 0,
            driven_m: 0.0,
            last: None,
            commands: CommandAccount::default(),
            progress: Progress::default(),
            crash_last_step: false,
        }
    }

    /// The seed of the episode.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The action of a command, or the brake when there is none.
    pub fn obey(&mut self, moment: &Moment, command: Option<&Command>) -> Action {
        let action = self.commands.obey(command, moment.now);
        // A tick is counted at its first instant, as those of a robot in Rust.
        if self.tick.replace(moment.tick) != Some(moment.tick) {
            self.ticks += 1;
            self.commands.end_tick();
        }
        action
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
            braked: self.commands.braked(),
            command_age_max_ns: self.commands.age_max_ns(),
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
            braked: self.commands.braked(),
            outcome: outcome.code(),
            crash_last_step: u32::from(self.crash_last_step),
            command_digest: self.commands.digest(),
            skipped,
        }
    }
}
