//! A robot as the plant of a world process.

use shm_config::config::Config;
use shm_config::message::{Command, Episode, Observation, Outcome, Progress};
use vehicle::{Action, Scanner};

use crate::account::CommandAccount;
use crate::plant::{Moment, Plant};
use crate::robot::{Contact, Reading, Robot, Status};

/// A robot with the account of its episode. It brakes between two episodes, and when it is
/// dropped: no command holds while nothing decides whether it may be obeyed.
pub struct Driven<R: Robot> {
    robot: R,
    /// Time from instant to instant, s.
    step_s: f64,
    /// Time from tick to tick of the run, s.
    tick_s: f64,
    horizon_ticks: u64,
    scanner: Scanner,
    seed: u64,
    account: CommandAccount,
    status: Status,
    last: Action,
    speed_mps: f64,
    driven_m: f64,
    /// The run's newest tick that is in the account.
    tick: Option<u64>,
    ticks: u64,
    vehicle_contacts: u64,
    object_contacts: u64,
}

impl<R: Robot> Driven<R> {
    /// A robot in a run of this configuration; no episode has begun.
    pub fn new(robot: R, config: &Config) -> Self {
        Self {
            robot,
            step_s: 1.0 / config.world_rate_hz(),
            tick_s: config.run.period_ns() as f64 * 1e-9,
            horizon_ticks: u64::from(config.world.horizon_ticks),
            scanner: config.scanner,
            seed: 0,
            account: CommandAccount::default(),
            status: Status::default(),
            last: Action::BRAKE,
            speed_mps: 0.0,
            driven_m: 0.0,
            tick: None,
            ticks: 0,
            vehicle_contacts: 0,
            object_contacts: 0,
        }
    }

    /// Counts a tick of the run at its first instant.
    fn count(&mut self, tick: u64) {
        if self.tick.replace(tick) == Some(tick) {
            return;
        }
        self.ticks += 1;
        self.account.end_tick();
        match self.status.contact {
            Contact::Free => {}
            Contact::Vehicle => self.vehicle_contacts += 1,
            Contact::Object => self.object_contacts += 1,
        }
    }
}

impl<R: Robot> Plant for Driven<R> {
    fn begin(&mut self, _episode: u32, seed: u64) -> Result<(), String> {
        // A machine obeys its last command until the next, and this may take long.
        self.robot.brake(0.0);
        self.robot.begin(seed)?;
        self.seed = seed;
        self.account = CommandAccount::default();
        self.status = self.robot.status();
        self.last = Action::BRAKE;
        self.speed_mps = 0.0;
        self.driven_m = 0.0;
        self.tick = None;
        self.ticks = 0;
        self.vehicle_contacts = 0;
        self.object_contacts = 0;
        Ok(())
    }

    fn advance(&mut self, moment: Moment, command: Option<&Command>) -> Option<Outcome> {
        // A simulation that was stopped for a minute must not move by a minute at once.
        let step_s = ((moment.missed + 1) as f64 * self.step_s).min(self.tick_s);
        // By the speed of the observation before.
        self.driven_m += self.speed_mps.abs() * step_s;
        self.last = self.account.obey(command, moment.now);
        match command {
            Some(_) => self.robot.obey(self.last, step_s),
            None => self.robot.brake(step_s),
        }
        self.status = self.robot.status();
        self.count(moment.tick);
        self.status
            .ended
            .filter(|outcome| *outcome != Outcome::Driving)
            .or((self.ticks >= self.horizon_ticks).then_some(Outcome::MaxStep))
    }

    fn observe(&mut self, _moment: Moment, observation: &mut Observation) -> Reading {
        observation.ego.steer = self.last.steer;
        observation.ego.pedal = self.last.pedal;
        observation.set_fan(&self.scanner.fan());
        observation.lidar_max_m = self.scanner.range_m as f32;
        let reading = self.robot.read(observation);
        if reading == Reading::Fresh {
            self.speed_mps = observation.ego.speed_mps;
        }
        reading
    }

    fn progress(&self, outcome: Outcome) -> Progress {
        Progress {
            seed: self.seed,
            completion: self.status.completion,
            route_m: self.status.course_m,
            speed_mps: self.speed_mps,
            episode_ticks: self.ticks,
            vehicle_contacts: self.vehicle_contacts,
            object_contacts: self.object_contacts,
            braked: self.account.braked(),
            command_age_max_ns: self.account.age_max_ns(),
            outcome: outcome.code(),
            ..Progress::default()
        }
    }

    fn episode(&self, outcome: Outcome) -> Episode {
        Episode {
            seed: self.seed,
            ticks: self.ticks,
            completion: self.status.completion,
            driven_m: self.driven_m,
            vehicle_contacts: self.vehicle_contacts,
            object_contacts: self.object_contacts,
            braked: self.account.braked(),
            outcome: outcome.code(),
            crash_last_step: u32::from(self.status.contact != Contact::Free),
            command_digest: self.account.digest(),
            ..Episode::default()
        }
    }
}

impl<R: Robot> Drop for Driven<R> {
    /// The process ends: in any way but a kill.
    fn drop(&mut self) {
        self.robot.brake(0.0);
    }
}
