//! Reads recordings of MetaDrive from files.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use anyhow::{Context, bail, ensure};
use flate2::read::GzDecoder;
use serde::Deserialize;

use super::npz::Npz;

/// Prefix and suffix of the name of a scenario file.
const GOLDEN: (&str, &str) = ("golden_", ".json.gz");
/// Number of columns of the recorded ego states and flags.
const EGO_COLUMNS: usize = 11;
const FLAG_COLUMNS: usize = 6;
/// Number of columns of a recorded step response.
const RESPONSE_COLUMNS: usize = 8;

/// Every recorded scenario, by seed.
pub struct Golden {
    /// The scenarios.
    pub seeds: BTreeMap<u64, Scenario>,
}

/// One recorded scenario. Points are (x, y), m; angles rad, counter-clockwise.
#[derive(Debug, Deserialize)]
pub struct Scenario {
    /// The settings that differ from the paper's.
    pub config: Option<Config>,
    /// The blocks of the map, in the order of their creation.
    pub blocks: Vec<Block>,
    /// Lanes by road; keys are `from|to`.
    pub net: BTreeMap<String, Vec<Lane>>,
    /// The ego car.
    pub ego: Car,
    /// The nodes of the route.
    pub ckpt: Vec<String>,
    /// Length of the route, m.
    pub route_len: f64,
    /// Static obstacles.
    pub objects: Vec<Object>,
    /// Traffic by block, the last block first.
    pub traffic: Vec<Group>,
    /// The first observation.
    pub obs0: Vec<f64>,
}

/// Settings of a scenario.
#[derive(Debug, Default, Deserialize)]
pub struct Config {
    /// The number of blocks, or their letters.
    pub map: Option<serde_json::Value>,
    /// Number of lanes per direction.
    pub lane_count: Option<usize>,
    /// Lane width, m.
    pub lane_width_m: Option<f64>,
    /// Vehicles per ten metres.
    pub traffic_density: Option<f64>,
    /// Probability of an obstacle.
    pub accident_probability: Option<f64>,
}

/// One block of a map.
#[derive(Debug, Deserialize)]
pub struct Block {
    /// Letter of its kind.
    #[serde(rename = "ID")]
    pub letter: String,
    /// Seed of its random stream.
    pub seed: u64,
    /// Number of attempts to place it.
    pub trials: u32,
    /// The socket that it is attached to, such as `0I-socket0`; `None` for the first block.
    pub pre_socket: Option<String>,
    /// Its parameters, by name.
    pub cfg: BTreeMap<String, serde_json::Value>,
}

/// One lane.
#[derive(Debug, Deserialize)]
pub struct Lane {
    /// Class of the lane.
    #[serde(rename = "type")]
    pub class: String,
    /// Width, m.
    pub width: f64,
    /// Length, m.
    pub length: f64,
    /// Begin of the centre line.
    pub start: [f64; 2],
    /// End of the centre line.
    pub end: [f64; 2],
    /// Types of the left and the right line.
    pub lines: [String; 2],
    /// Colours of the left and the right line.
    pub colors: [String; 2],
    /// The circle of an arc.
    #[serde(flatten)]
    pub arc: Option<Arc>,
}

/// The circle of a curved lane.
#[derive(Debug, Deserialize)]
pub struct Arc {
    /// Centre.
    pub center: [f64; 2],
    /// Radius, m.
    pub radius: f64,
    /// Direction from the centre to the begin of the lane.
    pub start_phase: f64,
    /// Angle swept by the lane.
    pub angle: f64,
    /// Whether the lane turns right.
    pub clockwise: bool,
}

/// The ego car or a car of the traffic.
#[derive(Debug, Deserialize)]
pub struct Car {
    /// Class; `None` for the ego car.
    #[serde(default)]
    pub cls: Option<String>,
    /// Lane: from node, to node, number.
    pub lane: (String, String, u16),
    /// Position.
    pub pos: [f64; 2],
    /// Heading.
    pub heading: f64,
    /// Position along the lane, m; `None` for the ego car.
    #[serde(default)]
    pub long: Option<f64>,
    /// Length and width, m; `None` for the ego car.
    #[serde(default)]
    pub size: Option<[f64; 2]>,
    /// Mass, kg; `None` for the ego car.
    #[serde(default)]
    pub mass: Option<f64>,
    /// Engine force per wheel, N.
    pub engine: f64,
    /// Brake force.
    pub brake: f64,
    /// Initial value of the lane-change timer.
    #[serde(default)]
    pub overtake_timer: Option<u32>,
    /// The nodes of the route.
    #[serde(default)]
    pub ckpt: Vec<String>,
}

/// A static obstacle.
#[derive(Debug, Deserialize)]
pub struct Object {
    /// Class.
    pub cls: String,
    /// Position.
    pub pos: [f64; 2],
    /// Heading.
    pub heading: f64,
}

/// The traffic of one block.
#[derive(Debug, Deserialize)]
pub struct Group {
    /// The road on which the ego car triggers it.
    pub trigger: Vec<String>,
    /// The cars.
    pub vehicles: Vec<Car>,
}

/// The names in a folder, sorted.
fn names(folder: &Path) -> anyhow::Result<Vec<String>> {
    let entries = std::fs::read_dir(folder)
        .with_context(|| format!("{}: cannot read this folder", folder.display()))?;
    let mut names: Vec<String> = entries
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .collect();
    names.sort();
    Ok(names)
}

impl Golden {
    /// Reads every `golden_*.json.gz` of a folder.
    ///
    /// # Errors
    /// If there is none, or one is invalid.
    pub fn read(folder: &Path) -> anyhow::Result<Golden> {
        let mut seeds = BTreeMap::new();
        for name in names(folder)? {
            if !(name.starts_with(GOLDEN.0) && name.ends_with(GOLDEN.1)) {
                continue;
            }
            let path = folder.join(&name);
            let read = || -> anyhow::Result<BTreeMap<u64, Scenario>> {
                let unpacked = GzDecoder::new(BufReader::new(File::open(&path)?));
                Ok(serde_json::from_reader(BufReader::new(unpacked))?)
            };
            seeds.extend(read().with_context(|| path.display().to_string())?);
        }
        ensure!(
            !seeds.is_empty(),
            "{}: no {}*{} here: --data names the folder of the recordings",
            folder.display(),
            GOLDEN.0,
            GOLDEN.1
        );
        Ok(Golden { seeds })
    }
}

/// Reads the recorded step responses from `dynamics.json`; `None` without that file.
///
/// # Errors
/// If the file is invalid.
pub fn step_responses(folder: &Path) -> anyhow::Result<Option<StepResponses>> {
    let path = folder.join("dynamics.json");
    if !path.exists() {
        return Ok(None);
    }
    let read = || anyhow::Ok(serde_json::from_reader(BufReader::new(File::open(&path)?))?);
    read().with_context(|| path.display().to_string()).map(Some)
}

/// Responses of a car on a straight road to a held action.
#[derive(Debug, Deserialize)]
pub struct StepResponses {
    /// Engine and brake forces of the car.
    pub params: Vec<Forces>,
    /// x, y, heading and speed per tick, by the name of the action.
    #[serde(flatten)]
    pub responses: BTreeMap<String, Vec<[f64; RESPONSE_COLUMNS]>>,
}

/// Engine and brake forces of a car.
#[derive(Debug, Deserialize)]
pub struct Forces {
    /// Engine force per wheel, N.
    pub max_engine_force: f64,
    /// Brake force.
    pub max_brake_force: f64,
}

/// The kinds of recorded drives: the folders in `rollouts`.
///
/// # Errors
/// If there is no such folder.
pub fn rollout_kinds(folder: &Path) -> anyhow::Result<Vec<String>> {
    names(&folder.join("rollouts"))
}

/// One recorded drive; row t is the state before action t.
pub struct Rollout {
    /// Seed of the drive.
    pub seed: u64,
    /// Features; all rows have the same length.
    pub features: Vec<Vec<f32>>,
    /// Steering and pedal.
    pub actions: Vec<[f64; 2]>,
    /// States of the ego car.
    pub ego: Vec<Ego>,
    /// Flags after action t.
    pub judged: Vec<Judged>,
}

/// State of the ego car at one instant.
#[derive(Clone, Copy, Debug)]
pub struct Ego {
    /// Position, m.
    pub position: [f64; 2],
    /// Heading, rad, counter-clockwise.
    pub heading_rad: f64,
    /// Velocity, m/s.
    pub velocity: [f64; 2],
    /// Yaw rate, rad/s, counter-clockwise.
    pub yaw_rate_radps: f64,
    /// Distances to the road's left and right edge, m.
    pub edges_m: [f64; 2],
    /// Driven share of the route.
    pub completion: f64,
    /// Number of completed roads of the route.
    pub roads_done: usize,
    /// Whether a lane lies under the car.
    pub on_lane: bool,
}

/// The simulator's flags of one tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Judged {
    /// Contact with a vehicle.
    pub vehicle: bool,
    /// Contact with a cone, a triangle or a barrier.
    pub object: bool,
    /// The ego car was on a sidewalk.
    pub sidewalk: bool,
    /// The ego car was off the road.
    pub out_of_road: bool,
    /// The ego car had arrived.
    pub arrived: bool,
}

impl From<&[f64; EGO_COLUMNS]> for Ego {
    fn from(row: &[f64; EGO_COLUMNS]) -> Ego {
        let [
            x,
            y,
            heading_rad,
            vx,
            vy,
            yaw_rate_radps,
            left_m,
            right_m,
            completion,
            roads,
            lane,
        ] = *row;
        Ego {
            position: [x, y],
            heading_rad,
            velocity: [vx, vy],
            yaw_rate_radps,
            edges_m: [left_m, right_m],
            completion,
            roads_done: roads as usize,
            on_lane: lane != 0.0,
        }
    }
}

impl From<&[bool; FLAG_COLUMNS]> for Judged {
    fn from(row: &[bool; FLAG_COLUMNS]) -> Judged {
        let [vehicle, object, sidewalk, out_of_road, arrived, _max_step] = *row;
        Judged {
            vehicle,
            object,
            sidewalk,
            out_of_road,
            arrived,
        }
    }
}

impl Judged {
    /// Whether a vehicle or an object was touched.
    pub fn touched(&self) -> bool {
        self.vehicle || self.object
    }
}

impl Rollout {
    /// Reads every drive of a kind, sorted by name.
    ///
    /// # Errors
    /// If a file is invalid.
    pub fn read_all(folder: &Path, kind: &str) -> anyhow::Result<Vec<Rollout>> {
        let folder = folder.join("rollouts").join(kind);
        let mut rollouts = Vec::new();
        for name in names(&folder)? {
            let number = name.strip_prefix("seed");
            let Some(number) = number.and_then(|rest| rest.strip_suffix(".npz")) else {
                continue;
            };
            let path = folder.join(&name);
            let read = number.parse().map_err(anyhow::Error::from);
            let read = read.and_then(|seed| Rollout::read(&path, seed));
            rollouts.push(read.with_context(|| path.display().to_string())?);
        }
        rollouts.sort_by_key(|rollout| rollout.seed);
        Ok(rollouts)
    }

    fn read(path: &Path, seed: u64) -> anyhow::Result<Rollout> {
        let archive = Npz::open(path)?;
        let (width, features) = archive.matrix::<f32>("obs")?;
        let (columns, actions) = archive.matrix::<f64>("act")?;
        ensure!(columns == 2, "act has {columns} columns");
        let (columns, ego) = archive.matrix::<f64>("ego")?;
        ensure!(columns == EGO_COLUMNS, "ego has {columns} columns");
        let (columns, flags) = archive.matrix::<bool>("flags")?;
        ensure!(columns == FLAG_COLUMNS, "flags has {columns} columns");
        let rollout = Rollout {
            seed,
            features: features.chunks_exact(width).map(<[f32]>::to_vec).collect(),
            actions: actions.as_chunks().0.to_vec(),
            ego: ego.as_chunks().0.iter().map(Ego::from).collect(),
            judged: flags.as_chunks().0.iter().map(Judged::from).collect(),
        };
        let ticks = rollout.actions.len();
        let seen = [rollout.features.len(), rollout.ego.len()];
        if seen != [ticks + 1; 2] || rollout.judged.len() != ticks {
            bail!("{ticks} actions, but {seen:?} rows before and after them");
        }
        Ok(rollout)
    }
}
