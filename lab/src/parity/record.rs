//! What was recorded of MetaDrive, read from files.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use anyhow::{Context, bail, ensure};
use flate2::read::GzDecoder;
use npyz::NpyFile;
use serde::Deserialize;
use zip::ZipArchive;

/// Begin and end of the name of a file of scenarios.
const GOLDEN: (&str, &str) = ("golden_", ".json.gz");
/// Columns of a recorded drive that are read here.
const EGO_COLUMNS: usize = 11;
const FLAG_COLUMNS: usize = 6;
/// Columns of a recorded step response.
const RESPONSE_COLUMNS: usize = 8;

/// Every recorded scenario, by seed.
pub struct Golden {
    /// The scenarios.
    pub seeds: BTreeMap<u64, Scenario>,
}

/// One recorded scenario. Points are (x, y), m; angles rad, counter-clockwise.
#[derive(Debug, Deserialize)]
pub struct Scenario {
    /// The settings it was made with, where they are not the paper's.
    pub config: Option<Config>,
    /// The blocks of its map, in the order of their making.
    pub blocks: Vec<Block>,
    /// Lanes by road, `from|to`.
    pub net: BTreeMap<String, Vec<Lane>>,
    /// The ego.
    pub ego: Car,
    /// The nodes of its route.
    pub ckpt: Vec<String>,
    /// The route's length, m.
    pub route_len: f64,
    /// What stands in the way.
    pub objects: Vec<Object>,
    /// Traffic by block, the last block first.
    pub traffic: Vec<Group>,
    /// The first observation.
    pub obs0: Vec<f64>,
}

/// Settings of a scenario.
#[derive(Debug, Default, Deserialize)]
pub struct Config {
    /// A number of blocks or their letters.
    pub map: Option<serde_json::Value>,
    /// Lanes in one direction.
    pub lane_count: Option<usize>,
    /// Their width, m.
    pub lane_width_m: Option<f64>,
    /// Vehicles per ten metres.
    pub traffic_density: Option<f64>,
    /// Probability of an obstacle.
    pub accident_probability: Option<f64>,
}

/// One block of a map.
#[derive(Debug, Deserialize)]
pub struct Block {
    /// The letter of its kind.
    #[serde(rename = "ID")]
    pub letter: String,
    /// Seed of its own stream.
    pub seed: u64,
    /// How many samples it took.
    pub trials: u32,
    /// What it is attached to, such as `0I-socket0`; none of the first.
    pub pre_socket: Option<String>,
    /// Its measures, by name.
    pub cfg: BTreeMap<String, serde_json::Value>,
}

/// One lane.
#[derive(Debug, Deserialize)]
pub struct Lane {
    /// Its class.
    #[serde(rename = "type")]
    pub class: String,
    /// Its width, m.
    pub width: f64,
    /// Its length, m.
    pub length: f64,
    /// Where its centre line begins.
    pub start: [f64; 2],
    /// Where it ends.
    pub end: [f64; 2],
    /// The lines on its left and right.
    pub lines: [String; 2],
    /// Their colours.
    pub colors: [String; 2],
    /// The circle, if it is an arc.
    #[serde(flatten)]
    pub arc: Option<Arc>,
}

/// The circle of a lane that bends.
#[derive(Debug, Deserialize)]
pub struct Arc {
    /// Its centre.
    pub center: [f64; 2],
    /// Its radius, m.
    pub radius: f64,
    /// Direction from the centre to where the lane begins.
    pub start_phase: f64,
    /// The angle that the lane sweeps.
    pub angle: f64,
    /// Whether it bends to the right.
    pub clockwise: bool,
}

/// The ego or a car of the traffic.
#[derive(Debug, Deserialize)]
pub struct Car {
    /// Its class; none for the ego.
    #[serde(default)]
    pub cls: Option<String>,
    /// From node, to node, number.
    pub lane: (String, String, u16),
    /// Its place.
    pub pos: [f64; 2],
    /// Its heading.
    pub heading: f64,
    /// Its place along the lane, m; not of the ego.
    #[serde(default)]
    pub long: Option<f64>,
    /// Its length and width, m; not of the ego.
    #[serde(default)]
    pub size: Option<[f64; 2]>,
    /// Its mass, kg; not of the ego.
    #[serde(default)]
    pub mass: Option<f64>,
    /// Engine force per wheel, N.
    pub engine: f64,
    /// Brake force.
    pub brake: f64,
    /// Where its lane-change timer begins.
    #[serde(default)]
    pub overtake_timer: Option<u32>,
    /// The nodes of its route.
    #[serde(default)]
    pub ckpt: Vec<String>,
}

/// A thing in the way.
#[derive(Debug, Deserialize)]
pub struct Object {
    /// Its class.
    pub cls: String,
    /// Its place.
    pub pos: [f64; 2],
    /// Its heading.
    pub heading: f64,
}

/// The traffic of one block.
#[derive(Debug, Deserialize)]
pub struct Group {
    /// The road on which the ego starts it.
    pub trigger: Vec<String>,
    /// Its cars.
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
    /// When there is none, or one is not what it should be.
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

/// The recorded step responses, where there are any: `dynamics.json`.
///
/// # Errors
/// When the file is there but not what it should be.
pub fn step_responses(folder: &Path) -> anyhow::Result<Option<StepResponses>> {
    let path = folder.join("dynamics.json");
    if !path.exists() {
        return Ok(None);
    }
    let read = || anyhow::Ok(serde_json::from_reader(BufReader::new(File::open(&path)?))?);
    read().with_context(|| path.display().to_string()).map(Some)
}

/// What a car on a straight road does when one action is held.
#[derive(Debug, Deserialize)]
pub struct StepResponses {
    /// The car's engine and brake.
    pub params: Vec<Forces>,
    /// x, y, heading, speed tick by tick, by the name of the action.
    #[serde(flatten)]
    pub responses: BTreeMap<String, Vec<[f64; RESPONSE_COLUMNS]>>,
}

/// A car's engine and brake.
#[derive(Debug, Deserialize)]
pub struct Forces {
    /// Engine force per wheel, N.
    pub max_engine_force: f64,
    /// Brake force.
    pub max_brake_force: f64,
}

/// The kinds of recorded drives in a folder: the folders in `rollouts`.
///
/// # Errors
/// When there is no such folder.
pub fn rollout_kinds(folder: &Path) -> anyhow::Result<Vec<String>> {
    names(&folder.join("rollouts"))
}

/// One recorded drive; row t is what was before action t.
pub struct Rollout {
    /// Its seed.
    pub seed: u64,
    /// Features; all rows have the same number.
    pub features: Vec<Vec<f32>>,
    /// Steer and pedal.
    pub actions: Vec<[f64; 2]>,
    /// The ego.
    pub ego: Vec<Ego>,
    /// What action t brought.
    pub judged: Vec<Judged>,
}

/// The ego at one instant of a drive.
#[derive(Clone, Copy, Debug)]
pub struct Ego {
    /// Position, m.
    pub position: [f64; 2],
    /// Heading, rad, counter-clockwise.
    pub heading_rad: f64,
    /// Velocity, m/s.
    pub velocity: [f64; 2],
    /// How fast it turns, rad/s, counter-clockwise.
    pub yaw_rate_radps: f64,
    /// Distances to the road's left and right edge, m.
    pub edges_m: [f64; 2],
    /// Share of the route driven.
    pub completion: f64,
    /// How many roads of the route lie behind.
    pub roads_done: usize,
    /// Whether a lane is under it.
    pub on_lane: bool,
}

/// How the simulator judged one tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Judged {
    /// A vehicle was touched.
    pub vehicle: bool,
    /// A cone, a triangle or a barrier was touched.
    pub object: bool,
    /// The ego was on a sidewalk.
    pub sidewalk: bool,
    /// The ego was out of the road.
    pub out_of_road: bool,
    /// The ego had arrived.
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
    /// Whether anything was touched that moves or stands in the way.
    pub fn touched(&self) -> bool {
        self.vehicle || self.object
    }
}

impl Rollout {
    /// Reads every drive of a kind, by name.
    ///
    /// # Errors
    /// When a file is not what it should be.
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
        let mut archive = ZipArchive::new(BufReader::new(File::open(path)?))?;
        let (width, features) = array::<f32>(&mut archive, "obs")?;
        let (columns, actions) = array::<f64>(&mut archive, "act")?;
        ensure!(columns == 2, "act has {columns} columns");
        let (columns, ego) = array::<f64>(&mut archive, "ego")?;
        ensure!(columns == EGO_COLUMNS, "ego has {columns} columns");
        let (columns, flags) = array::<bool>(&mut archive, "flags")?;
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

/// The columns and the values of a matrix.
fn array<T: npyz::Deserialize>(
    archive: &mut ZipArchive<BufReader<File>>,
    name: &str,
) -> anyhow::Result<(usize, Vec<T>)> {
    let entry = archive.by_name(&format!("{name}.npy"));
    let file = NpyFile::new(entry.with_context(|| format!("no array '{name}'"))?)?;
    let columns = match file.shape() {
        [_, columns] if *columns > 0 => *columns as usize,
        shape => bail!("array '{name}' has the shape {shape:?}: not a matrix"),
    };
    Ok((columns, file.into_vec()?))
}
