//! The expert's tracker against the built-in world, which knows how its bodies move.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use hdrhistogram::Histogram;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use shm_config::counted;
use shm_config::message::Observation;
use sim::contact::Shape;
use sim::world::{Body, BodyKind};
use sim::{World, WorldConfig};
use stack::Clock;
use stack::driver::{DriverKind, EpisodeDriver, planning_histogram};
use stack::episode::drive;
use supervisor::cli::parsers::whole;
use supervisor::subcommand::{Configuration, Output, Subcommand, say, write_json_option};
use tracker::Tracker;
use vehicle::{Point, Pose, Vector, pose};

use crate::gauges::Gauges;
use lab::report::table;

/// A body is seen when a return is at most this far from its outline, m.
const NEAR_M: f64 = 0.2;
/// A body at least this fast moves, m/s, and one at most that fast rests; what is between is
/// not counted.
const MOVING_MPS: f64 = 2.0;
const RESTING_MPS: f64 = 0.3;
/// A body that rests counts as taken for moving from this speed on, m/s.
const ALARM_MPS: f64 = 0.5;
/// Upper ends of the rows' distances from the car's middle, m.
const BINS_M: [f64; 4] = [8.0, 15.0, 25.0, f64::INFINITY];

/// Compare what the expert's tracker tells of other bodies with how they move.
#[derive(Debug, Args)]
#[command(
    after_help = "MetaDrive's own driver drives, so that the scans do not depend on the tracker.\n\n\
        Examples:\n  \
        ./vlaps bench tracker --json tracker.json\n  \
        ./vlaps bench tracker --episodes 100 --set world.traffic_density=0.2"
)]
pub struct BenchTracker {
    /// Number of episodes.
    #[arg(long, value_name = "N", default_value_t = 50, allow_negative_numbers = true,
          value_parser = whole::<u64>(1..=1_000_000))]
    pub episodes: u64,
    /// Seed of the first episode.
    #[arg(long, value_name = "N", default_value_t = 1000, allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub first_seed: u64,
    /// Configuration and overrides.
    #[command(flatten)]
    pub configuration: Configuration,
    /// Also write the figures to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// What was told of the bodies at some distance. Shares are of scans in which a body was seen;
/// `None` without any.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The distances.
    pub distance: &'static str,
    /// Scans of moving cars.
    pub moving: u64,
    /// Share of them in which the car is taken for resting.
    pub missed: Option<f64>,
    /// How far the velocity of the others is off, m/s: half of them at most this.
    pub off_p50_mps: f64,
    /// 90 % of them at most this, m/s.
    pub off_p90_mps: f64,
    /// Scans of cars that rest.
    pub resting: u64,
    /// Share of them in which the car is taken for moving.
    pub alarms: Option<f64>,
    /// Scans of cones, barriers and broken-down cars.
    pub objects: u64,
    /// Share of them in which the object is taken for moving.
    pub object_alarms: Option<f64>,
}

/// All measurements.
#[derive(Clone, Debug, Serialize)]
pub struct TrackerResults {
    /// One row per distance.
    pub rows: Vec<Row>,
    /// Seed of the first episode.
    pub first_seed: u64,
    /// Episodes driven.
    pub episodes: u64,
    /// Scans taken in.
    pub scans: u64,
    /// Processor time of a scan, us: 50 and 99 %.
    pub scan_p50_us: u64,
    /// The same, 99 %.
    pub scan_p99_us: u64,
}

impl Subcommand for BenchTracker {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::json(&self.json)]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let config = self.configuration.resolve()?;
        let period_ns = config.run.period_ns();
        let mut world = World::new(WorldConfig::from(&config))?;
        let mut driver = EpisodeDriver::new(DriverKind::Idm, &config, clock)?;
        let mut watch = Watch::new(Gauges::new(clock), period_ns as f64 * 1e-9);
        let bar = ProgressBar::new(self.episodes);
        bar.set_style(ProgressStyle::with_template(
            "{elapsed_precise} {wide_bar} {pos}/{len} episodes, {eta} left",
        )?);
        for episode in 0..self.episodes {
            let seed = self.first_seed.wrapping_add(episode);
            watch.begin();
            drive(&mut world, &mut driver, (seed, period_ns), |tick| {
                watch.scan(tick.observation);
                watch.bodies = tick.world.bodies().collect();
            })?;
            bar.inc(1);
        }
        bar.finish_and_clear();
        let results = TrackerResults {
            rows: watch.bins.iter().map(Bin::row).collect(),
            first_seed: self.first_seed,
            episodes: self.episodes,
            scans: watch.scan_us.len(),
            scan_p50_us: watch.scan_us.value_at_quantile(0.5),
            scan_p99_us: watch.scan_us.value_at_quantile(0.99),
        };
        print(&results);
        write_json_option(&self.json, &results)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// What was told of bodies at some distance.
struct Bin {
    distance: &'static str,
    missed: Share,
    alarms: Share,
    object_alarms: Share,
    /// How far velocities are off, mm/s.
    off_mmps: Histogram<u64>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Share {
    of: u64,
    count: u64,
}

impl Share {
    fn note(&mut self, is_one: bool) {
        self.of += 1;
        self.count += u64::from(is_one);
    }

    fn value(self) -> Option<f64> {
        (self.of > 0).then(|| self.count as f64 / self.of as f64)
    }
}

impl Bin {
    fn new(distance: &'static str) -> Self {
        Self {
            distance,
            missed: Share::default(),
            alarms: Share::default(),
            object_alarms: Share::default(),
            off_mmps: planning_histogram(),
        }
    }

    fn row(&self) -> Row {
        let off_mps = |share| self.off_mmps.value_at_quantile(share) as f64 * 1e-3;
        Row {
            distance: self.distance,
            moving: self.missed.of,
            missed: self.missed.value(),
            off_p50_mps: off_mps(0.5),
            off_p90_mps: off_mps(0.9),
            resting: self.alarms.of,
            alarms: self.alarms.value(),
            objects: self.object_alarms.of,
            object_alarms: self.object_alarms.value(),
        }
    }
}

struct Watch {
    tracker: Tracker,
    gauges: Gauges,
    step_s: f64,
    /// The bodies as they were when the next scan is taken; none at the first one.
    bodies: Vec<Body>,
    bins: [Bin; BINS_M.len()],
    scan_us: Histogram<u64>,
}

impl Watch {
    fn new(gauges: Gauges, step_s: f64) -> Self {
        Self {
            tracker: Tracker::default(),
            gauges,
            step_s,
            bodies: Vec::new(),
            bins: ["to 8 m", "to 15 m", "to 25 m", "beyond"].map(Bin::new),
            scan_us: planning_histogram(),
        }
    }

    /// An episode begins.
    fn begin(&mut self) {
        self.tracker.forget();
        self.bodies.clear();
    }

    fn scan(&mut self, observation: &Observation) {
        let begun = self.gauges.core();
        self.tracker.update(observation, self.step_s);
        let core = self.gauges.core() - begun;
        self.scan_us.saturating_record(core.as_micros() as u64);
        let ego = &observation.ego;
        let world_from_body = pose(ego.x_world_m, ego.y_world_m, ego.heading_world_rad);
        for body in &self.bodies {
            let Some(told) = self.told(body, &world_from_body) else {
                continue;
            };
            let distance_m = (world_from_body.inverse() * body.placed.center_world)
                .coords
                .norm();
            let index = BINS_M.iter().position(|end_m| distance_m < *end_m);
            let bin = &mut self.bins[index.unwrap_or(BINS_M.len() - 1)];
            let speed_mps = body.velocity_world.norm();
            let is_alarm = told.norm() >= ALARM_MPS;
            match body.kind {
                BodyKind::Obstacle(_) => bin.object_alarms.note(is_alarm),
                BodyKind::Traffic(_) if speed_mps <= RESTING_MPS => bin.alarms.note(is_alarm),
                BodyKind::Traffic(_) if speed_mps >= MOVING_MPS => {
                    bin.missed.note(told == Vector::zeros());
                    if told != Vector::zeros() {
                        let off_mmps = (told - body.velocity_world).norm() * 1e3;
                        bin.off_mmps.saturating_record(off_mmps as u64);
                    }
                }
                BodyKind::Traffic(_) => {}
            }
        }
    }

    /// The mean velocity that the returns of a body were given, in the world's frame, m/s;
    /// `None` when none of them is seen.
    fn told(&self, body: &Body, world_from_body: &Pose) -> Option<Vector> {
        let sightings = self.tracker.sightings().iter();
        let its = sightings
            .filter(|sighting| distance_m(body, world_from_body * sighting.point_body) < NEAR_M);
        let (count, sum) = its.fold((0, Vector::zeros()), |(count, sum), sighting| {
            (count + 1, sum + sighting.velocity_body)
        });
        (count > 0).then(|| world_from_body.rotation * (sum / f64::from(count)))
    }
}

/// Distance of a point from a body's outline, m; negative inside.
fn distance_m(body: &Body, point_world: Point) -> f64 {
    let away = point_world - body.placed.center_world;
    match body.placed.shape {
        Shape::Box(footprint) => {
            let forward = body.placed.forward_world;
            let at = Point::new(away.dot(&forward), forward.perp(&away));
            footprint.distance_m(at)
        }
        Shape::Disc { radius_m } => away.norm() - radius_m,
    }
}

fn print(results: &TrackerResults) {
    let mut table = table(&[
        "distance", "moving", "missed", "off p50", "p90 m/s", "resting", "false", "objects",
        "false",
    ]);
    let share = |share: Option<f64>| share.map_or("-".to_string(), |share| format!("{share:.4}"));
    for row in &results.rows {
        table.add_row([
            row.distance.to_string(),
            row.moving.to_string(),
            share(row.missed),
            format!("{:.2}", row.off_p50_mps),
            format!("{:.2}", row.off_p90_mps),
            row.resting.to_string(),
            share(row.alarms),
            row.objects.to_string(),
            share(row.object_alarms),
        ]);
    }
    say(table);
    say(format_args!(
        "{} of {} from seed {}; a scan takes {} us (p50), {} us (p99) of processor time; moving: \
         at least {MOVING_MPS} m/s, resting: at most {RESTING_MPS} m/s",
        counted(results.scans, "scan"),
        counted(results.episodes, "episode"),
        results.first_seed,
        results.scan_p50_us,
        results.scan_p99_us,
    ));
}
