//! Reads what was recorded of MetaDrive, where it is at hand: the folder named
//! by `VLAPS_GOLDEN`, else `shared/data` beside the repository.
#![allow(dead_code)]

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use npyz::npz::NpzArchive;

/// The first seed recorded.
pub const FIRST_SEED: u64 = 100;
/// How many seeds are recorded.
pub const SEEDS: u64 = 50;

/// The folder of the recordings, or `None` with a printed reason.
pub fn folder() -> Option<PathBuf> {
    let named = std::env::var_os("VLAPS_GOLDEN").map(PathBuf::from);
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let folder = named.unwrap_or_else(beside);
    if folder.join("golden_100.json.gz").is_file() {
        return Some(folder);
    }
    println!(
        "skipped: no recordings in {} (set VLAPS_GOLDEN)",
        folder.display()
    );
    None
}

/// `golden_100.json.gz`, by seed.
pub fn golden(folder: &Path) -> serde_json::Value {
    let file = File::open(folder.join("golden_100.json.gz")).expect("golden file opens");
    let mut text = String::new();
    flate2::read::GzDecoder::new(file)
        .read_to_string(&mut text)
        .expect("golden file unpacks");
    serde_json::from_str(&text).expect("golden file is JSON")
}

/// The step responses.
pub fn step_responses(folder: &Path) -> serde_json::Value {
    let file = File::open(folder.join("dynamics.json")).expect("dynamics.json opens");
    serde_json::from_reader(BufReader::new(file)).expect("dynamics.json is JSON")
}

/// One recorded drive; row t is what was seen before action t.
pub struct Rollout {
    pub seed: u64,
    /// 259 features.
    pub obs: Vec<Vec<f32>>,
    /// Steer and pedal.
    pub act: Vec<[f64; 2]>,
    /// x, y, heading, vx, vy, yaw rate, left, right, completion, checkpoint, on lane.
    pub ego: Vec<[f64; 11]>,
    /// Vehicle, object, sidewalk, out of road, arrived, max step; after action t.
    pub flags: Vec<[bool; 6]>,
    /// x, y, heading, length, width, speed of each car; NaN where there is none.
    pub traffic: Vec<Vec<[f32; 6]>>,
}

impl Rollout {
    /// Reads `rollouts/KIND/seedN.npz`.
    pub fn read(folder: &Path, kind: &str, seed: u64) -> Rollout {
        let path = folder.join(format!("rollouts/{kind}/seed{seed}.npz"));
        let mut archive = NpzArchive::open(&path).expect("rollout opens");
        let obs: Vec<f32> = array(&mut archive, "obs").1;
        let act: Vec<f64> = array(&mut archive, "act").1;
        let ego: Vec<f64> = array(&mut archive, "ego").1;
        let flags: Vec<bool> = array(&mut archive, "flags").1;
        let (shape, traffic): (_, Vec<f32>) = array(&mut archive, "traffic");
        let cars = shape[1] as usize;
        Rollout {
            seed,
            obs: obs.chunks_exact(259).map(<[f32]>::to_vec).collect(),
            act: rows(&act),
            ego: rows(&ego),
            flags: rows(&flags),
            traffic: (0..shape[0] as usize)
                .map(|tick| rows(&traffic[tick * cars * 6..(tick + 1) * cars * 6]))
                .collect(),
        }
    }
}

fn array<T: npyz::Deserialize>(
    archive: &mut NpzArchive<BufReader<File>>,
    name: &str,
) -> (Vec<u64>, Vec<T>) {
    let file = archive
        .by_name(name)
        .expect("rollout is a zip")
        .expect("array is there");
    (file.shape().to_vec(), file.into_vec().expect("array reads"))
}

fn rows<T: Copy, const N: usize>(flat: &[T]) -> Vec<[T; N]> {
    flat.as_chunks::<N>().0.to_vec()
}
