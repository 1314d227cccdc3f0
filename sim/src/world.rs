//! The world: episodes by seed, one tick of 0.1 s at a time.

mod fetch;

use shm_config::message::{Observation, Outcome};
use vehicle::{Action, Point, Pose, Vector, pose};

use crate::bodies::{Bodies, Fixture, Mover, Touch, floor_after_drop_m};
use crate::config::{OutOfRoute, WorldConfig, WorldError};
use crate::contact::{Placed, Shape};
use crate::delay::Delay;
use crate::dynamics::{Car, Motion, SUBSTEPS};
use crate::idm::{Idm, View};
use crate::lidar::Lidar;
use crate::map::Map;
use crate::model::VehicleKind;
use crate::navigation::Navigator;
use crate::observe;
use crate::places::places;
use crate::rules::{Beside, Edges, Sidewalks, has_arrived};
use crate::spawn::{ObstacleKind, Scenario, ScenarioConfig};
use crate::traffic::Traffic;

/// The result of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepOutcome {
    /// Whether and how the episode has ended.
    pub outcome: Outcome,
    /// What the ego touched during the tick.
    pub touch: Touch,
    /// Whether the ego's box is on a sidewalk.
    pub on_sidewalk: bool,
}

impl StepOutcome {
    const BEGINNING: StepOutcome = StepOutcome {
        outcome: Outcome::Driving,
        touch: Touch {
            vehicle: false,
            object: false,
        },
        on_sidewalk: false,
    };

    /// Whether the episode is over.
    pub fn has_ended(&self) -> bool {
        self.outcome != Outcome::Driving
    }
}

/// What kind of body it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BodyKind {
    /// A car that waits or drives.
    Traffic(VehicleKind),
    /// Something in the way, a broken-down car included.
    Obstacle(ObstacleKind),
}

/// A body other than the ego, with its true pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// What it is.
    pub kind: BodyKind,
    /// Its shape and place.
    pub placed: Placed,
    /// Its velocity, m/s.
    pub velocity_world: Vector,
}

/// An episode, and what is needed to begin the next one. The fields that every tick
/// reads are first, in the order of use: in a batch they are fetched before the tick.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct World {
    navigator: Navigator,
    step: StepOutcome,
    last_action: Action,
    ticks: u64,
    /// Sub-steps of the current tick that are done, and what the ego touched in them.
    substeps: usize,
    touch: Touch,
    driven_m: f64,
    /// The ego's seen headings before each of the last five sub-steps; the one
    /// that the next sub-step overwrites is the oldest, a tick ago.
    headings_world: [Vector; SUBSTEPS as usize],
    lidar: Lidar,
    delay: Delay,
    bodies: Bodies,
    traffic: Traffic,
    map: Map,
    config: WorldConfig,
    /// The sidewalks around the ego.
    beside: Beside,
    sidewalks: Sidewalks,
    scenario_config: ScenarioConfig,
}

impl World {
    /// A world at the beginning of the episode of seed 0.
    ///
    /// # Errors
    /// [`WorldError`] if the configuration is out of range.
    pub fn new(config: WorldConfig) -> Result<World, WorldError> {
        let scenario_config = config.scenario()?;
        let scenario = Scenario::generate(&scenario_config, 0)?;
        let ego = &scenario.ego;
        let place = &ego.place;
        let navigator = Navigator::new(
            &scenario.map.network,
            &ego.route,
            place.lane,
            place.position_world,
        );
        let mut world = World {
            lidar: Lidar::new(&config.scanner),
            delay: Delay::of(&config.vehicle),
            config,
            scenario_config,
            map: scenario.map.clone(),
            sidewalks: Sidewalks::default(),
            beside: Beside::default(),
            navigator,
            bodies: Bodies::default(),
            traffic: Traffic::new(),
            ticks: 0,
            driven_m: 0.0,
            last_action: Action::default(),
            substeps: 0,
            touch: Touch::default(),
            headings_world: [Vector::x(); SUBSTEPS as usize],
            step: StepOutcome::BEGINNING,
        };
        world.begin(scenario);
        Ok(world)
    }

    /// Begins the episode of a seed. The same seed is the same episode, bit by
    /// bit.
    ///
    /// # Errors
    /// [`WorldError`] if the configuration is out of range or this seed has no
    /// map; the episode before then goes on.
    pub fn reset(&mut self, seed: u64) -> Result<(), WorldError> {
        let scenario = Scenario::generate(&self.scenario_config, seed)?;
        self.begin(scenario);
        Ok(())
    }

    fn begin(&mut self, scenario: Scenario) {
        let network = &scenario.map.network;
        let ego = &scenario.ego;
        let position = ego.place.position_world;
        let car = Car::ego(&self.config.vehicle, ego.forces);
        let at = pose(position.x, position.y, ego.place.heading_rad);
        let motion = Motion::at_rest(at, car.model);
        self.navigator = Navigator::new(network, &ego.route, ego.place.lane, position);
        self.navigator
            .update(network, position, motion.seen_forward());
        self.headings_world.fill(motion.seen_forward());
        (self.substeps, self.touch) = (0, Touch::default());
        self.bodies.clear();
        self.bodies.push(Mover::new(ego.kind, car, motion));
        let fixtures = scenario.obstacles.iter().filter_map(Fixture::new);
        self.bodies.fixtures.extend(fixtures);
        self.traffic.place(&scenario, &mut self.bodies);
        self.bodies.reserve();
        self.sidewalks.lay(network);
        self.beside = Beside::default();
        self.map = scenario.map;
        self.ticks = 0;
        self.driven_m = 0.0;
        self.last_action = Action::default();
        self.delay.forget();
        self.lidar.begin(scenario.noise);
        self.step = StepOutcome::BEGINNING;
    }

    /// Drives for one tick of 0.1 s, or to the end of one that has begun; a
    /// non-finite action brakes. After the end of the episode nothing moves and
    /// the outcome repeats.
    pub fn step(&mut self, action: Action) -> StepOutcome {
        self.advance(action, SUBSTEPS as usize - self.substeps)
            .unwrap_or(self.step)
    }

    /// Drives for one sub-step of 0.02 s; returns the tick's outcome with the last
    /// sub-step of a tick. Five calls with one action equal [`World::step`] bit by bit.
    /// A new action is applied immediately; an equal one continues with the pedals and
    /// the wheel as they were set for it. Traffic decisions and rules run once in a
    /// tick.
    pub fn substep(&mut self, action: Action) -> Option<StepOutcome> {
        self.advance(action, 1)
    }

    /// Drives for some of the sub-steps that are left of the tick.
    fn advance(&mut self, action: Action, count: usize) -> Option<StepOutcome> {
        if self.step.has_ended() {
            return Some(self.step);
        }
        let action = action.clamped();
        if self.substeps == 0 {
            let ego_lane = self.navigator.lane();
            let network = &self.map.network;
            self.traffic.trigger(network.road_of(ego_lane));
            self.traffic.drive(network, &mut self.bodies, ego_lane);
        }
        match self.delay.is_none() {
            true => self.drive(action, count),
            false => {
                for _ in 0..count {
                    let effective = self.delay.pass(action);
                    self.drive(effective, 1);
                }
            }
        }
        (self.substeps == SUBSTEPS as usize).then(|| self.end_tick())
    }

    /// Moves all bodies by some sub-steps, the ego with an action that takes effect now.
    fn drive(&mut self, action: Action, count: usize) {
        let begins = self.substeps == 0;
        if begins || action != self.last_action {
            self.bodies.command(0, action);
            self.last_action = action;
        }
        if begins {
            self.touch = Touch::default();
            self.bodies.find_pairs();
        }
        let substeps = self.substeps..self.substeps + count;
        let headings_world = &mut self.headings_world[substeps];
        self.bodies.advance(headings_world, &mut self.touch);
        self.substeps += count;
    }

    fn end_tick(&mut self) -> StepOutcome {
        let network = &self.map.network;
        self.traffic.follow(network, &mut self.bodies);
        let motion = &self.bodies.movers[0].motion;
        self.navigator
            .update(network, motion.seen_position(), motion.seen_forward());
        self.driven_m += self.navigator.moved_m();
        self.substeps = 0;
        self.ticks += 1;
        self.step = self.judge(self.touch);
        self.step
    }

    fn judge(&mut self, touch: Touch) -> StepOutcome {
        let ego = self.ego_seen();
        let on_sidewalk = self.sidewalks.touch_near(&ego, &mut self.beside);
        let network = &self.map.network;
        let position = ego.center_world;
        let outside = self.config.out_of_route == OutOfRoute::Ends
            && Edges::of(network, &self.navigator, position).is_outside();
        let outcome = if has_arrived(network, &self.navigator, position) {
            Outcome::Arrived
        } else if !self.navigator.is_on_lane() || on_sidewalk || outside {
            Outcome::OutOfRoad
        } else if self.ticks >= self.config.horizon_steps {
            Outcome::MaxStep
        } else {
            Outcome::Driving
        };
        StepOutcome {
            outcome,
            touch,
            on_sidewalk,
        }
    }

    /// Fills the present observation; header and instants are not changed.
    pub fn observe(&self, observation: &mut Observation) {
        self.observe_between(0.0, observation);
    }

    /// The observation when a share of the next sub-step, [0, 1), has passed. As in
    /// MetaDrive, the observed pose is interpolated, the bodies that the beams hit are
    /// not, and the lane is that of the last tick.
    pub fn observe_between(&self, passed: f64, observation: &mut Observation) {
        let network = &self.map.network;
        let motion = &self.bodies.movers[0].motion.between(passed);
        let before_world = self.heading_before(passed);
        observation.ego = observe::ego(motion, before_world, self.last_action);
        observation.road = observe::road(network, &self.navigator, motion);
        observation.checkpoints = observe::checkpoints(network, &self.navigator, motion);
        observation.lidar_max_m = self.lidar.range_m() as f32;
        observation.set_fan(self.lidar.fan());
        let origin = self.lidar.origin(motion);
        let reach_m = self.lidar.range_m();
        let is_near = |away: Vector, radius_m: f64| {
            let most_m = reach_m + radius_m;
            away.norm_squared() <= most_m * most_m
        };
        let Bodies {
            movers,
            spots,
            fixtures,
            ..
        } = &self.bodies;
        let cars = places(&spots[1..], |spot| {
            let away = spot.center_world - origin.position_world;
            spot.present & is_near(away, spot.radius_m)
        });
        let seen = cars
            .map(|place| &movers[place + 1])
            .filter(|mover| self.is_at_beam_height(mover));
        let things = places(fixtures, |fixture| {
            let away = fixture.placed.center_world - origin.position_world;
            is_near(away, fixture.radius_m)
        });
        let bodies = seen
            .map(Mover::placed)
            .chain(things.map(|place| fixtures[place].placed));
        self.lidar.scan(&origin, bodies, &mut observation.ranges_m);
        // Of an instant and an episode, the same returns are lost in every run.
        let instant = (self.ticks << 3) + self.substeps as u64;
        let draw = (self.seed(), instant ^ passed.to_bits());
        self.lidar.disturb(draw, &mut observation.ranges_m);
    }

    /// The ego's seen heading a tick before that moment, as a unit vector.
    fn heading_before(&self, passed: f64) -> Vector {
        let oldest = self.headings_world[self.substeps];
        let next = self.headings_world[(self.substeps + 1) % self.headings_world.len()];
        match passed > 0.0 {
            true => (oldest + (next - oldest) * passed).normalize(),
            false => oldest,
        }
    }

    /// All cars are dropped from half their height when an episode begins: a truck is
    /// above the beams for the first two ticks.
    fn is_at_beam_height(&self, mover: &Mover) -> bool {
        let floor_m = floor_after_drop_m(mover.car.model.height_m / 2.0, self.ticks);
        mover.is_at_beam_height(floor_m.max(mover.motion.floor_m()))
    }

    /// What MetaDrive's traffic driver would do in the ego's place.
    pub fn advise(&mut self, idm: &mut Idm) -> Action {
        let ego_lane = self.navigator.lane();
        let (bodies, lanes) = self.traffic.look(&self.bodies, ego_lane);
        idm.act(&View {
            network: &self.map.network,
            navigator: &self.navigator,
            bodies,
            lanes,
            own: 0,
        })
    }

    /// Bodies other than the ego, with their true poses.
    pub fn bodies(&self) -> impl Iterator<Item = Body> {
        let movers = self.bodies.movers.iter().enumerate().skip(1);
        let cars = movers
            .filter(|&(index, _)| self.bodies.spots[index].present)
            .map(|(index, mover)| Body {
                kind: match self.traffic.is_broken_down(index) {
                    true => BodyKind::Obstacle(ObstacleKind::BrokenDown(mover.kind)),
                    false => BodyKind::Traffic(mover.kind),
                },
                placed: mover.placed(),
                velocity_world: mover.motion.velocity_world(),
            });
        cars.chain(self.bodies.fixtures.iter().map(|fixture| Body {
            kind: BodyKind::Obstacle(fixture.kind),
            placed: fixture.placed,
            velocity_world: Vector::zeros(),
        }))
    }

    /// The ego's rectangle where observations see it.
    pub fn ego_seen(&self) -> Placed {
        let ego = &self.bodies.movers[0];
        Placed {
            shape: Shape::Box(vehicle::Footprint {
                length_m: ego.car.model.length_m,
                width_m: ego.car.model.width_m,
            }),
            center_world: ego.motion.seen_position(),
            forward_world: ego.motion.seen_forward(),
        }
    }

    /// The ego's pose, as observations give it.
    pub fn world_from_ego(&self) -> Pose {
        self.bodies.movers[0].motion.seen()
    }

    /// The ego's position, as observations give it.
    pub fn ego_position(&self) -> Point {
        self.bodies.movers[0].motion.seen_position()
    }

    /// The ego's car: its measures and engine.
    pub fn ego_car(&self) -> &Car {
        &self.bodies.movers[0].car
    }

    /// The ego's motion.
    pub fn ego_motion(&self) -> &Motion {
        &self.bodies.movers[0].motion
    }

    /// Speed of the ego over the ground, m/s.
    pub fn speed_mps(&self) -> f64 {
        self.bodies.movers[0].motion.speed_mps()
    }

    /// Share of the route driven.
    pub fn completion(&self) -> f64 {
        self.navigator.completion()
    }

    /// Length of the route, m.
    pub fn route_m(&self) -> f64 {
        self.navigator.length_m()
    }

    /// Length driven in this episode, m.
    pub fn driven_m(&self) -> f64 {
        self.driven_m
    }

    /// Ticks of this episode so far.
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Seed of this episode.
    pub fn seed(&self) -> u64 {
        self.map.seed
    }

    /// The result of the last tick.
    pub fn last_step(&self) -> StepOutcome {
        self.step
    }

    /// The map of this episode.
    pub fn map(&self) -> &Map {
        &self.map
    }

    /// Its sidewalks.
    pub fn sidewalks(&self) -> &Sidewalks {
        &self.sidewalks
    }

    /// The ego's progress along its route.
    pub fn navigator(&self) -> &Navigator {
        &self.navigator
    }

    /// The configuration of the episodes.
    pub fn config(&self) -> &WorldConfig {
        &self.config
    }
}
