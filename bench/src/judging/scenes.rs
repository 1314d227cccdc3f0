//! Scenes for a judge, with the ground truth from the simulator.

use anyhow::{Context, anyhow};
use gate::presentation::Party;
use gate::presentation::picture::{Photo, Proposals};
use gate::record::{Outlook, Proposed};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use shm_config::config::Config;
use shm_config::message::{Camera, Observation, Outcome, Proposal, View};
use sim::observe::TICK_S;
use sim::render::{Renderer, Shot};
use sim::render_thread::{HORIZON_S, outlook};
use sim::{World, WorldConfig};
use vehicle::{Action, Vehicle};

use stack::Clock;
use stack::driver::{DriverKind, EpisodeDriver};

/// Largest number of ticks between two examined ticks; the number is drawn at random.
const TICKS_BETWEEN: u64 = 40;
/// Maximum number of scenes per episode, so that many maps are covered.
const SCENES_OF_EPISODE: usize = 6;
/// Policy actions tried at one tick, to find one whose outcome differs from that of
/// the expert's action.
const TRIES: usize = 4;
/// Number of episodes without a scene after which the search fails.
const BARREN_MAX: u64 = 200;

/// A moment of a drive with two proposals and their simulated outcomes.
pub struct Scene {
    /// Seed of the episode.
    pub seed: u64,
    /// Tick of the episode.
    pub tick: u64,
    /// Speed of the car, m/s.
    pub speed_mps: f64,
    /// What the car saw.
    pub observation: Box<Observation>,
    /// The expert's action and a possible action of a policy, with the safety check's
    /// measurements of both.
    pub proposed: [Proposed; 2],
    /// Outcome of holding each action, the expert's first.
    pub outlooks: [Outlook; 2],
    /// One picture per requested view.
    pub shots: Vec<Taken>,
}

/// A picture of the world.
pub struct Taken {
    /// Camera.
    pub view: View,
    camera: Camera,
    size_px: [u32; 2],
    rgb: Vec<u8>,
}

impl Taken {
    /// The picture as a buffer to draw into.
    pub fn photo(&self) -> Photo<'_> {
        let [width, height] = self.size_px;
        Photo {
            camera: &self.camera,
            width,
            height,
            rgb: &self.rgb,
        }
    }
}

impl Scene {
    /// The proposals to draw.
    pub fn proposals<'a>(&self, vehicle: &'a Vehicle) -> Proposals<'a> {
        Proposals {
            vehicle,
            speed_mps: self.speed_mps,
            expert: action(&self.proposed[0]),
            policy: action(&self.proposed[1]),
        }
    }

    /// The driver whose action ends well while the other's does not.
    pub fn safer(&self) -> Party {
        match self.outlooks[0].is_accident() {
            true => Party::Policy,
            false => Party::Expert,
        }
    }
}

fn action(proposed: &Proposed) -> Action {
    Action {
        steer: proposed.steer,
        pedal: proposed.pedal,
    }
}

/// Parameters of the search for scenes.
#[derive(Debug, Clone, Copy)]
pub struct Search<'a> {
    /// Number of scenes.
    pub scenes: usize,
    /// Seed of the first episode and of all random draws.
    pub first_seed: u64,
    /// Cameras of each scene.
    pub views: &'a [View],
    /// Width and height of the pictures, pixels.
    pub size_px: [u32; 2],
}

/// Drives episodes with the expert, examines ticks drawn at random, and calls `found`
/// with each scene in which exactly one of both proposals, held, ends in an accident.
/// The same search yields the same scenes.
///
/// # Errors
/// If the configuration is invalid, a map cannot be made, too few scenes are found, or
/// `found` fails.
pub fn search(
    search: &Search,
    config: &Config,
    clock: Clock,
    mut found: impl FnMut(Scene) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let mut world = World::new(WorldConfig::from(config))?;
    let mut driver = EpisodeDriver::new(DriverKind::Expert, config, clock)?;
    let mut photos = Photos {
        renderer: Renderer::default(),
        views: search.views,
        size_px: search.size_px,
    };
    let mut chance = Chance(Xoshiro256PlusPlus::seed_from_u64(search.first_seed));
    let mut wanted = search.scenes;
    for seed in search.first_seed.. {
        if wanted == 0 {
            break;
        }
        if seed - search.first_seed > BARREN_MAX + search.scenes as u64 {
            return Err(anyhow!("too few scenes in {BARREN_MAX} episodes"));
        }
        let most = wanted.min(SCENES_OF_EPISODE);
        let mut drive = Drive {
            config,
            world: &mut world,
            driver: &mut driver,
            chance: &mut chance,
        };
        wanted -= drive.episode((seed, most), &mut photos, &mut found)?;
    }
    Ok(())
}

struct Drive<'a> {
    config: &'a Config,
    world: &'a mut World,
    driver: &'a mut EpisodeDriver,
    chance: &'a mut Chance,
}

impl Drive<'_> {
    /// Drives one episode; returns the number of scenes found.
    fn episode(
        &mut self,
        (seed, most): (u64, usize),
        photos: &mut Photos,
        found: &mut impl FnMut(Scene) -> anyhow::Result<()>,
    ) -> anyhow::Result<usize> {
        self.world.reset(seed)?;
        self.driver.begin(seed);
        photos.renderer.begin(self.world);
        let mut observation = Box::<Observation>::default();
        let mut count = 0;
        let mut next = 1 + self.chance.below(TICKS_BETWEEN);
        let mut tick = 0;
        while !self.world.last_step().has_ended() && count < most {
            self.world.observe(&mut observation);
            observation.header.tick = tick;
            observation.header.taken_ns = tick * 100_000_000;
            let command = self.driver.command(&observation, self.world);
            if tick == next {
                next += 1 + self.chance.below(TICKS_BETWEEN);
                if let Some(mut scene) = self.scene((seed, tick), command.action(), &observation) {
                    scene.shots = photos.take(self.world)?;
                    found(scene)?;
                    count += 1;
                }
            }
            self.world.step(command.action());
            tick += 1;
        }
        Ok(count)
    }

    /// The scene of this tick, if some policy action has another outcome than the expert's.
    fn scene(
        &mut self,
        (seed, tick): (u64, u64),
        expert: Action,
        observation: &Observation,
    ) -> Option<Scene> {
        let (vehicle, limits) = (&self.config.vehicle, &self.config.safety);
        let speed_mps = observation.ego.speed_mps;
        let reach_m = safety::Scene::reach_m(vehicle, limits, speed_mps);
        let seen = safety::Scene::new(observation, reach_m);
        let proposed = |action: Action| {
            let assessment = safety::assess(vehicle, limits, &seen, Some(action));
            Proposed::new(&Proposal::new(Some(action)), &assessment)
        };
        let expert_outlook = outlook_of(self.world, Party::Expert, expert)?;
        (0..TRIES).find_map(|_| {
            let policy = self.chance.policy(expert);
            let outlooks = [
                expert_outlook,
                outlook_of(self.world, Party::Policy, policy)?,
            ];
            if outlooks[0].is_accident() == outlooks[1].is_accident() {
                return None;
            }
            Some(Scene {
                seed,
                tick,
                speed_mps,
                observation: Box::new(*observation),
                proposed: [proposed(expert)?, proposed(policy)?],
                outlooks,
                shots: Vec::new(),
            })
        })
    }
}

/// Outcome of holding an action. `None` where the rules of the episode differ from
/// what a picture shows: leaving the route for another road ends an episode, too,
/// but no picture shows the route.
fn outlook_of(world: &World, party: Party, action: Action) -> Option<Outlook> {
    let by_rule = outlook(world, action);
    let seen = Outlook {
        party,
        horizon_s: HORIZON_S,
        contact_s: by_rule.contact_s,
        out_s: by_rule.out_s,
    };
    let is_out = by_rule.out_s < HORIZON_S && by_rule.contact_s >= HORIZON_S;
    (!is_out || leaves_pavement(world, action)).then_some(seen)
}

/// Whether the car leaves all lanes or enters a sidewalk when it holds an action.
fn leaves_pavement(world: &World, action: Action) -> bool {
    let mut world = world.clone();
    let ticks = (HORIZON_S / TICK_S).round() as u64;
    (0..ticks).any(|_| {
        let step = world.step(action);
        step.on_sidewalk || (step.outcome == Outcome::OutOfRoad && is_off_lanes(&world))
    })
}

/// Whether no lane lies under the car's centre.
fn is_off_lanes(world: &World) -> bool {
    !world.navigator().is_on_lane()
}

struct Photos<'a> {
    renderer: Renderer,
    views: &'a [View],
    size_px: [u32; 2],
}

impl Photos<'_> {
    fn take(&mut self, world: &World) -> anyhow::Result<Vec<Taken>> {
        let renderer = &mut self.renderer;
        let shots = self.views.iter().map(|&view| {
            let shot = Shot {
                view,
                size_px: self.size_px,
                passed: 0.0,
            };
            let picture = renderer.draw(world, &shot).context("the picture's size")?;
            Ok(Taken {
                view,
                camera: picture.camera,
                size_px: picture.size_px,
                rgb: picture.rgb.to_vec(),
            })
        });
        shots.collect()
    }
}

/// Source of random draws.
struct Chance(Xoshiro256PlusPlus);

impl Chance {
    /// Uniform in [0, 1).
    fn share(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 * 2f64.powi(-53)
    }

    /// Uniform in [-1, 1).
    fn signed(&mut self) -> f64 {
        2.0 * self.share() - 1.0
    }

    /// Uniform in 0..`end`.
    fn below(&mut self, end: u64) -> u64 {
        (self.share() * end as f64) as u64
    }

    /// A possible policy action where the expert proposes `expert`: slightly different,
    /// very different, straight on, or arbitrary.
    fn policy(&mut self, expert: Action) -> Action {
        match self.below(4) {
            0 => Action {
                steer: expert.steer + 0.15 * self.signed(),
                pedal: expert.pedal + 0.3 * self.signed(),
            },
            1 => Action {
                steer: expert.steer + 0.5 * self.signed(),
                pedal: expert.pedal + 0.5 * self.signed(),
            },
            2 => Action {
                steer: 0.0,
                pedal: self.share(),
            },
            _ => Action {
                steer: 0.6 * self.signed(),
                pedal: self.signed(),
            },
        }
        .clamped()
    }
}
