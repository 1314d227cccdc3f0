//! Options of a batch of environments, which Python passes as one JSON text.

use serde::{Deserialize, Serialize};
use sim::{RewardConfig, WorldConfig, WorldError};
use vehicle::InvalidVehicle;

/// Upper bound of seeds: Python passes them as signed numbers.
pub const SEEDS_END: u64 = 1 << 63;

/// Behaviour at the end of an episode (Gymnasium's `AutoresetMode`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Autoreset {
    /// The step that ends an episode begins the next one and returns its first observation;
    /// the last observation of the ended episode is returned beside it.
    SameStep,
    /// The step after the one that ends an episode begins the next one and ignores its
    /// action.
    NextStep,
    /// The caller resets.
    #[default]
    Disabled,
}

impl Autoreset {
    /// Parses a name of Gymnasium's `AutoresetMode`.
    ///
    /// # Errors
    /// One line with the valid names.
    pub fn parse(name: &str) -> Result<Autoreset, String> {
        match name {
            "SameStep" => Ok(Autoreset::SameStep),
            "NextStep" => Ok(Autoreset::NextStep),
            "Disabled" => Ok(Autoreset::Disabled),
            _ => Err(format!(
                "autoreset_mode {name}: choose from SameStep, NextStep, Disabled"
            )),
        }
    }
}

/// The seeds of the episodes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Seeds {
    /// The first seed of the range.
    pub first: u64,
    /// Number of seeds in the range; they repeat after it.
    pub count: u64,
    /// Whether each pass through the range has a new random order.
    pub shuffled: bool,
    /// Seed of the random order.
    pub order_seed: u64,
    /// If not empty, these seeds instead of the range.
    pub listed: Vec<u64>,
}

impl Default for Seeds {
    fn default() -> Seeds {
        Seeds {
            first: 0,
            count: 1,
            shuffled: false,
            order_seed: 0,
            listed: Vec::new(),
        }
    }
}

impl Seeds {
    /// Number of different seeds.
    fn len(&self) -> u64 {
        match self.listed.len() {
            0 => self.count,
            count => count as u64,
        }
    }

    /// The seed of the n-th episode of a batch. World k of n takes the positions k, k + n,
    /// k + 2n, ..., so that no result depends on which world ends first.
    pub fn at(&self, place: u64) -> u64 {
        let count = self.len();
        let (pass, mut index) = (place / count, place % count);
        if self.shuffled {
            index = permuted(
                index,
                count,
                self.order_seed ^ pass.wrapping_mul(0x9e37_79b9),
            );
        }
        match self.listed.get(index as usize) {
            Some(&seed) => seed,
            None => self.first + index,
        }
    }
}

/// The position of an index in a pseudo-random order of `0..count`, without a table: a
/// Feistel network over the next power of four, repeated until it falls into the range.
fn permuted(index: u64, count: u64, key: u64) -> u64 {
    let half_bits = (64 - (count - 1).leading_zeros()).div_ceil(2).max(1);
    let mask = (1u64 << half_bits) - 1;
    let mut value = index;
    loop {
        let (mut left, mut right) = (value >> half_bits, value & mask);
        for round in 0..4u64 {
            let mut mixed = right
                .wrapping_add(key)
                .wrapping_add(round.wrapping_mul(0xd1b5_4a32_d192_ed03));
            // The finaliser of SplitMix64 (Steele, Lea, Flood 2014).
            mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            (left, right) = (right, (left ^ mixed ^ (mixed >> 31)) & mask);
        }
        value = left << half_bits | right;
        if value < count {
            return value;
        }
    }
}

/// Why a scanner is refused, with MetaDrive's names.
fn scanner_refusal(wrong: &InvalidVehicle) -> String {
    let InvalidVehicle { name, value, range } = wrong;
    match *name {
        // Without a beam, the world's scanner sees nothing.
        "beams" => format!(
            "num_lasers = {value}: it must be between 0 and {}",
            range[1]
        ),
        "range_m" => format!(
            "distance = {value}: it must be between {} and {} m",
            range[0], range[1]
        ),
        _ => format!("lidar {wrong}"),
    }
}

/// All options of a batch.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Options {
    /// Options of the world.
    #[serde(default)]
    pub world: WorldConfig,
    /// Weights of reward and cost.
    #[serde(default)]
    pub reward: RewardConfig,
    /// Whether contact with a vehicle ends an episode.
    #[serde(default)]
    pub crash_vehicle_done: bool,
    /// Whether contact with an object ends an episode.
    #[serde(default)]
    pub crash_object_done: bool,
    /// Standard deviation of the noise on each beam, as a share of its range.
    #[serde(default)]
    pub beam_noise: f64,
    /// Probability that a beam returns nothing.
    #[serde(default)]
    pub beam_dropout: f64,
    /// The seeds of the episodes.
    pub seeds: Seeds,
    /// Behaviour at the end of an episode. It is not part of the text: a state from a batch
    /// may be restored in a single environment.
    #[serde(skip)]
    pub autoreset: Autoreset,
}

impl Options {
    /// Parses and checks the JSON text.
    ///
    /// # Errors
    /// One line that names the option and its valid values.
    pub fn parse(text: &str) -> Result<Options, String> {
        let options: Options = serde_json::from_str(text).map_err(|error| error.to_string())?;
        if options.seeds.len() == 0 {
            return Err("num_scenarios = 0: an environment needs at least one seed".into());
        }
        let seeds = &options.seeds;
        if seeds
            .first
            .checked_add(seeds.count)
            .is_none_or(|end| end > SEEDS_END)
        {
            return Err(format!(
                "start_seed = {}, num_scenarios = {}: a seed must be below 2**63",
                seeds.first, seeds.count
            ));
        }
        match options.world.scenario() {
            Ok(_) => {}
            Err(WorldError::Scanner(wrong)) => return Err(scanner_refusal(&wrong)),
            Err(other) => return Err(other.to_string()),
        }
        for (name, share) in [
            ("accident_prob", options.world.accident_probability),
            ("gaussian_noise", options.beam_noise),
            ("dropout_prob", options.beam_dropout),
        ] {
            if !(0.0..=1.0).contains(&share) {
                return Err(format!("{name} = {share}: it must be between 0 and 1"));
            }
        }
        Ok(options)
    }
}
