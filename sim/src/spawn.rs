//! What is on a map when an episode begins: the ego, obstacles, traffic.
//!
//! Equal to MetaDrive seed by seed: each of its managers has a stream of its
//! own, seeded with the map's seed, and the engine has one more that seeds
//! everything spawned, in this order: obstacles, ego, traffic. Sources:
//! the managers in `manager/` of MetaDrive, commit c29cc37.

mod obstacle;
mod traffic;

use vehicle::Point;

use crate::map::{BlockKind, BlockPlan, Map, MapConfig, MapError};
use crate::model::{Forces, VehicleKind};
use crate::rng::Stream;
use crate::road::{Direction, LaneId, Network, NodeId, RoadId};

/// How far along its lane the ego begins, m (`spawn_longitude`).
const EGO_LONGITUDINAL_M: f64 = 5.0;

/// What episodes are like; the defaults are the paper's experiment.
#[derive(Clone, Debug, PartialEq)]
pub struct ScenarioConfig {
    /// The map.
    pub map: MapConfig,
    /// Vehicles per ten metres of lane.
    pub traffic_density: f64,
    /// Probability of an obstacle on a block that may have one.
    pub accident_probability: f64,
    /// Whether each seed has its own number of lanes and blocks, density, probability, speed
    /// of the traffic and noise of the scan: [`ScenarioConfig::of_seed`].
    pub varied: bool,
    /// Speed at which the traffic drives on a free road; MetaDrive has 30 km/h.
    pub traffic_kmh: f64,
    /// What is wrong with the scans, beside what the scanner itself has.
    pub noise: ScanNoise,
}

/// What is wrong with scans.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ScanNoise {
    /// Probability that a beam's return is lost.
    pub drop_probability: f64,
    /// Standard deviation of a range, m.
    pub range_m: f64,
}

/// Changes the seed of a scenario into that of what is drawn for it.
const VARIETY: u64 = 0x7661_7269;
/// Lanes in one direction that a varied scenario may have.
const LANES: std::ops::RangeInclusive<u32> = 2..=4;
/// Random blocks that it may have.
const BLOCKS: std::ops::RangeInclusive<u32> = 1..=7;
/// The greatest traffic density that it may have.
const DENSITY_MAX: f64 = 0.3;
/// Speeds on a free road that its traffic may have, km/h.
const TRAFFIC_KMH: (f64, f64) = (20.0, 40.0);
/// The worst scans that it may have.
const NOISE_MAX: ScanNoise = ScanNoise {
    drop_probability: 0.05,
    range_m: 0.1,
};

impl ScenarioConfig {
    /// What the scenario of this seed is like. A varied one has 2 to 4 lanes, 1 to 7 random
    /// blocks unless their order is given, a traffic density of 0 to 0.3, an obstacle on
    /// a block with a probability of 0 to 1, traffic of 20 to 40 km/h, and a scan that loses 0
    /// to 5 % of its returns and whose ranges deviate by 0 to 0.1 m, each drawn evenly.
    #[must_use]
    pub fn of_seed(&self, seed: u64) -> ScenarioConfig {
        let mut config = self.clone();
        if self.varied {
            let mut stream = Stream::new(seed ^ VARIETY);
            let mut within = |range: std::ops::RangeInclusive<u32>| {
                let count = range.end() - range.start() + 1;
                (range.start() + stream.below(count)) as usize
            };
            config.map.lane_count = within(LANES);
            let blocks = within(BLOCKS);
            if let BlockPlan::Random(count) = &mut config.map.blocks {
                *count = blocks;
            }
            config.traffic_density = DENSITY_MAX * stream.unit();
            config.accident_probability = stream.unit();
            let (slow_kmh, fast_kmh) = TRAFFIC_KMH;
            config.traffic_kmh = slow_kmh + (fast_kmh - slow_kmh) * stream.unit();
            config.noise = ScanNoise {
                drop_probability: NOISE_MAX.drop_probability * stream.unit(),
                range_m: NOISE_MAX.range_m * stream.unit(),
            };
        }
        config
    }
}

impl Default for ScenarioConfig {
    fn default() -> ScenarioConfig {
        ScenarioConfig {
            map: MapConfig::default(),
            traffic_density: 0.06,
            accident_probability: 0.8,
            varied: false,
            traffic_kmh: 30.0,
            noise: ScanNoise::default(),
        }
    }
}

/// Why there is no scenario.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ScenarioError {
    /// There is no map.
    #[error(transparent)]
    Map(#[from] MapError),
    /// A density that is not between 0 and 1.
    #[error("a traffic density of {0}: it must be between 0 and 1")]
    TrafficDensity(f64),
    /// A probability that is not between 0 and 1.
    #[error("an obstacle probability of {0}: it must be between 0 and 1")]
    AccidentProbability(f64),
}

/// The roads to a goal, in driving order; never empty.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Route {
    /// Its roads.
    pub roads: Vec<RoadId>,
}

impl Route {
    /// The nodes it passes, first to last.
    pub fn checkpoints(&self, network: &Network) -> Vec<NodeId> {
        let first = self.roads.first().map(|&road| network.road(road).from);
        let rest = self.roads.iter().map(|&road| network.road(road).to);
        first.into_iter().chain(rest).collect()
    }

    /// Its length along the leftmost lanes, m.
    pub fn length_m(&self, network: &Network) -> f64 {
        let first_lane = |&road| network.lane(network.road(road).first_lane);
        self.roads
            .iter()
            .map(|road| first_lane(road).length_m)
            .sum()
    }
}

/// Where a car stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Its lane.
    pub lane: LaneId,
    /// How far along that lane, m.
    pub longitudinal_m: f64,
    /// Position of its centre.
    pub position_world: Point,
    /// Heading, rad, counter-clockwise; not wrapped.
    pub heading_rad: f64,
}

impl Place {
    fn new(network: &Network, lane: LaneId, longitudinal_m: f64) -> Place {
        let centerline = network.lane(lane);
        Place {
            lane,
            longitudinal_m,
            position_world: centerline.position(longitudinal_m, 0.0),
            heading_rad: centerline.heading_at(longitudinal_m),
        }
    }
}

/// A car, its place, and where it is going.
#[derive(Clone, Debug, PartialEq)]
pub struct Spawn {
    /// What car it is.
    pub kind: VehicleKind,
    /// Where it stands.
    pub place: Place,
    /// How strong it is.
    pub forces: Forces,
    /// Its route.
    pub route: Route,
}

/// What kind of thing stands in the way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObstacleKind {
    /// A traffic cone, a cylinder of 0.2 m radius.
    Cone,
    /// A warning triangle, a cylinder of 0.5 m radius.
    Warning,
    /// A barrier of 2.0 by 0.3 m.
    Barrier,
    /// A car that has broken down.
    BrokenDown(VehicleKind),
}

/// A thing that stands in the way, and stays there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle {
    /// What it is.
    pub kind: ObstacleKind,
    /// The lane on which it was put.
    pub lane: LaneId,
    /// Position of its centre.
    pub position_world: Point,
    /// Heading, rad, counter-clockwise; not wrapped.
    pub heading_rad: f64,
}

/// A car of the traffic.
#[derive(Clone, Debug, PartialEq)]
pub struct TrafficSpawn {
    /// The car.
    pub car: Spawn,
    /// At which count its lane-change timer begins, control steps.
    pub overtake_timer: u32,
}

/// The traffic of one block: it stands until the ego is on the trigger road.
#[derive(Clone, Debug, PartialEq)]
pub struct TrafficGroup {
    /// The last road of the block before, on the ego's side.
    pub trigger: RoadId,
    /// Its cars.
    pub cars: Vec<TrafficSpawn>,
}

/// A map with everything on it: where an episode begins.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// The map.
    pub map: Map,
    /// The ego.
    pub ego: Spawn,
    /// What stands in the way.
    pub obstacles: Vec<Obstacle>,
    /// The traffic, one group per block after the first, in order.
    pub traffic: Vec<TrafficGroup>,
    /// Its speed on a free road, km/h.
    pub traffic_kmh: f64,
    /// What is wrong with the scans.
    pub noise: ScanNoise,
}

impl Scenario {
    /// Generates the scenario of a seed.
    ///
    /// # Errors
    /// [`ScenarioError`] if the configuration is out of range or there is no
    /// map for it.
    pub fn generate(config: &ScenarioConfig, seed: u64) -> Result<Scenario, ScenarioError> {
        let unit = 0.0..=1.0;
        if !unit.contains(&config.traffic_density) {
            return Err(ScenarioError::TrafficDensity(config.traffic_density));
        }
        if !unit.contains(&config.accident_probability) {
            let probability = config.accident_probability;
            return Err(ScenarioError::AccidentProbability(probability));
        }
        let config = config.of_seed(seed);
        let map = Map::generate(&config.map, seed)?;
        Ok(furnish(&config, map))
    }
}

/// The streams that spawning draws from.
struct Streams {
    engine: Stream,
    traffic: Stream,
}

fn furnish(config: &ScenarioConfig, map: Map) -> Scenario {
    let mut streams = Streams {
        engine: Stream::new(map.seed),
        traffic: Stream::new(map.seed),
    };
    let probability = config.accident_probability;
    let (obstacles, closed_lanes) = obstacle::place(&map, &mut streams, probability);
    let goals = Goals::new(&map);
    let ego = place_ego(&map, &goals, &mut streams.engine);
    let traffic = traffic::Placement {
        map: &map,
        goals: &goals,
        closed_lanes: &closed_lanes,
        density: config.traffic_density,
    }
    .place(&mut streams);
    Scenario {
        map,
        ego,
        obstacles,
        traffic,
        traffic_kmh: config.traffic_kmh,
        noise: config.noise,
    }
}

fn place_ego(map: &Map, goals: &Goals, engine: &mut Stream) -> Spawn {
    let lane_count = map.spawn_lanes.len() as u32;
    let lane = map.spawn_lanes[Stream::new(map.seed).below(lane_count) as usize];
    let kind = VehicleKind::Default;
    Spawn {
        kind,
        place: Place::new(&map.network, lane, EGO_LONGITUDINAL_M),
        forces: sample_forces(kind, engine),
        route: goals.route(&map.network, lane),
    }
}

/// A spawned car gets a seed from the engine, and samples its forces.
fn sample_forces(kind: VehicleKind, engine: &mut Stream) -> Forces {
    let mut own = Stream::new(engine.spawn_seed());
    kind.forces(own.parameters())
}

/// Where cars go (`NodeNetworkNavigation.auto_assign_task`).
struct Goals {
    /// Cars that drive outbound go to a socket of the last block.
    outbound: Option<NodeId>,
    /// The others go to the beginning.
    inbound: Option<NodeId>,
}

impl Goals {
    fn new(map: &Map) -> Goals {
        let network = &map.network;
        let sockets = map.blocks.last().map_or(&[][..], |block| &block.sockets);
        let choice = match sockets.len() {
            0 | 1 => 0,
            // Every car draws anew from the map's seed, so all agree.
            count => Stream::new(map.seed).below(count as u32) as usize,
        };
        let outbound = sockets.get(choice);
        let inbound = map
            .blocks
            .iter()
            .find(|block| block.kind == BlockKind::First)
            .and_then(|block| block.sockets.first());
        Goals {
            outbound: outbound.map(|socket| network.road(socket.positive).to),
            inbound: inbound.map(|socket| network.road(socket.negative).to),
        }
    }

    /// The way from a lane to the goal; a car that cannot get there, or is
    /// already on the last road, has only its own road.
    fn route(&self, network: &Network, lane: LaneId) -> Route {
        let road = network.road_of(lane);
        let ends = network.road(road);
        let goal = match network.nodes()[ends.to.index()].direction {
            Direction::Outbound => self.outbound,
            Direction::Inbound => self.inbound,
        };
        let roads = goal
            .and_then(|goal| network.route(ends.from, goal))
            .filter(|roads| roads.len() > 1);
        Route {
            roads: roads.unwrap_or_else(|| vec![road]),
        }
    }
}
