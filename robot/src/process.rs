//! The world process: a plant between the ports of a world.

use runtime::{FixedRate, Flow, Member, SetUpError, TickLoop};
use shm_config::Instant;
use shm_config::config::Config;
use shm_config::message::{Observation, Outcome, Part};

use crate::clock::{Begin, WorldClock};
use crate::plant::Plant;
use crate::ports::Ports;
use crate::robot::Reading;

/// Runs a plant as the world of a run until its episodes or its time are over, or it is
/// stopped.
///
/// # Errors
/// When shared memory refuses, or the plant cannot begin an episode.
pub fn run(member: Member, plant: impl Plant, begin: Begin) -> Result<(), SetUpError> {
    let ports = Ports::open(&member.wire)?;
    let mut process = WorldProcess::new(&member.config, (plant, ports), begin)?;
    TickLoop::start(member)?.run(&mut process)
}

/// A plant with the ports of a world.
pub struct WorldProcess<P> {
    ports: Ports,
    plant: P,
    clock: WorldClock,
    observation: Box<Observation>,
}

impl<P: Plant> WorldProcess<P> {
    /// Begins the first episode.
    ///
    /// # Errors
    /// When the plant cannot begin it.
    pub fn new(
        config: &Config,
        (mut plant, ports): (P, Ports),
        begin: Begin,
    ) -> Result<Self, SetUpError> {
        let clock = WorldClock::new(config, begin);
        begin_episode(&mut plant, &clock)?;
        Ok(Self {
            ports,
            plant,
            clock,
            observation: Box::default(),
        })
    }

    /// Obeys the newest command up to this instant.
    fn advance(&mut self, run: &TickLoop) -> Result<Flow, SetUpError> {
        let (moment, command) = self.clock.command(run, &mut self.ports);
        let outcome = self.plant.advance(moment, command.as_ref());
        let is_over = self.clock.is_over(run);
        if let Some(outcome) = outcome.or(is_over.then_some(Outcome::Stopped)) {
            self.close_episode(outcome);
            if is_over || self.clock.is_last_episode() {
                return Ok(Flow::End);
            }
            self.clock.begin_next_episode();
            begin_episode(&mut self.plant, &self.clock)?;
        }
        Ok(Flow::Continue)
    }

    fn close_episode(&mut self, outcome: Outcome) {
        let mut episode = self.plant.episode(outcome);
        episode.header = self.clock.header();
        (_, episode.skipped) = self.clock.skipped();
        self.ports.episodes.send(&mut episode);
        tracing::info!(
            seed = episode.seed,
            %outcome,
            ticks = episode.ticks,
            completion = episode.completion,
            contacts = episode.contacts(),
            braked = episode.braked,
            "episode"
        );
        publish_progress(&self.plant, &self.clock, &mut self.ports, outcome);
    }

    /// Publishes the observation, if there is one.
    fn observe(&mut self, run: &mut TickLoop) -> Reading {
        let reading = self
            .plant
            .observe(self.clock.moment(), &mut self.observation);
        if reading == Reading::Fresh {
            run.telemetry.end(Part::Observe, run.now());
            let (ports, observation) = (&mut self.ports, &mut self.observation);
            let plant = &self.plant;
            self.clock.date(observation);
            self.clock.publish(run, ports, observation, |clock, ports| {
                publish_progress(plant, clock, ports, Outcome::Driving)
            });
        }
        reading
    }
}

fn publish_progress(plant: &impl Plant, clock: &WorldClock, ports: &mut Ports, outcome: Outcome) {
    let mut progress = plant.progress(outcome);
    progress.header = clock.header();
    (progress.skipped, _) = clock.skipped();
    ports.progress.send(&mut progress);
}

fn begin_episode(plant: &mut impl Plant, clock: &WorldClock) -> Result<(), SetUpError> {
    let seed = clock.seed();
    plant
        .begin(clock.episode(), seed)
        .map_err(|error| SetUpError::Own(format!("seed {seed}: {error}")))
}

impl<P: Plant> FixedRate for WorldProcess<P> {
    /// The instant at which the tick was released.
    type Due = Instant;

    fn ready(&mut self, run: &mut TickLoop) {
        self.clock.start(run);
    }

    fn update_connections(&mut self) {
        self.ports.update_connections();
    }

    /// The next tick then closes the episode.
    fn stop(&mut self, _run: &mut TickLoop, _now: Instant) -> Flow {
        Flow::Continue
    }

    fn await_tick(&mut self, run: &mut TickLoop) -> Option<Instant> {
        let is_due = self.clock.await_instant(run, &mut self.ports);
        is_due.then(|| self.clock.released())
    }

    fn tick(&mut self, run: &mut TickLoop, released: Instant) -> Result<Flow, SetUpError> {
        run.telemetry.begin(released);
        let is_first = self.clock.moment().index == 0;
        if !is_first && self.advance(run)? == Flow::End {
            self.clock.record_missed(run);
            return Ok(Flow::End);
        }
        run.telemetry.end(Part::Move, run.now());
        match self.clock.is_to_skip() || self.observe(run) == Reading::Lost {
            true => self.clock.skip_instant(run),
            false => self.clock.end_instant(run),
        }
        Ok(Flow::Continue)
    }

    fn finish(&mut self, run: &mut TickLoop) {
        self.clock.report(run);
    }
}
