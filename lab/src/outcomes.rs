//! How the episodes of an evaluation ended, map by map: two drivers on the same maps, and
//! intervals that hold for other maps, too.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use anyhow::{Context, bail, ensure};
use comfy_table::Table;
use serde::{Deserialize, Serialize};
use shm_config::config::{Simulator, World};
use toml::Table as TomlTable;

use crate::episodes::Cause;
use crate::metric::Metric;
use crate::report::table;
use crate::statistics::{over_both, sign_test};

/// The metrics that the failures of an evaluation tell for each map.
pub const KNOWN: [Metric; 2] = [Metric::Success, Metric::StrictSuccess];

/// Largest file of figures, bytes: more than a million failed episodes take.
const BYTES_MAX: u64 = 1 << 28;

/// The failures of an evaluation, as `./vlaps eval --json` and a training's final.json have
/// them.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcomes {
    driver: String,
    maps: Maps,
    failures: BTreeMap<u64, Cause>,
}

/// The settings of `[world]` that decide the maps of the seeds, and how long an episode may last.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct WorldSettings(BTreeMap<String, String>);

impl WorldSettings {
    /// Those of a configuration; `None` for worlds that draw their courses from something else.
    pub fn of(world: &World, simulator: Simulator) -> Option<WorldSettings> {
        if !matches!(simulator, Simulator::BuiltIn | Simulator::MetaDrive) {
            return None;
        }
        let table = TomlTable::try_from(world).ok()?;
        // `simulator` is a field of its own, and `rate_hz` changes no map.
        let decisive = table
            .into_iter()
            .filter(|(key, _)| !["simulator", "rate_hz"].contains(&key.as_str()));
        // As text, since a number of JSON may come back with other last bits.
        let texts = decisive.map(|(key, value)| (key, value.to_string()));
        Some(WorldSettings(texts.collect()))
    }

    /// The first setting that differs, in words: `world.blocks 7, not 3`. A setting that one of
    /// both does not have is of another build, and says nothing.
    fn difference(&self, other: &WorldSettings) -> Option<String> {
        let mut both = self.0.iter().filter_map(|(key, own)| {
            let theirs = other.0.get(key)?;
            (own != theirs).then(|| format!("world.{key} {own}, not {theirs}"))
        });
        both.next()
    }
}

/// The maps of an evaluation, as far as its file tells.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Maps {
    /// The world, as in `--world`.
    pub world: String,
    /// Seed of the first episode.
    pub first_seed: u64,
    /// Number of episodes.
    pub episodes: u64,
    /// `None` in a file of an earlier version, and as [`WorldSettings::of`].
    #[serde(rename = "world_settings")]
    pub settings: Option<WorldSettings>,
}

impl Maps {
    /// How these maps differ from others, in words; `None` where nothing shows that they do.
    fn difference(&self, other: &Maps) -> Option<String> {
        let are_seeds = (&self.world, self.first_seed, self.episodes)
            == (&other.world, other.first_seed, other.episodes);
        if !are_seeds {
            return Some(format!("{self}, not {other}"));
        }
        self.settings.as_ref()?.difference(other.settings.as_ref()?)
    }

    fn seeds(&self) -> impl Iterator<Item = u64> {
        (0..self.episodes).map(|index| self.first_seed.wrapping_add(index))
    }
}

impl fmt::Display for Maps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let last = self
            .first_seed
            .wrapping_add(self.episodes.saturating_sub(1));
        write!(f, "seeds {} to {last} in {}", self.first_seed, self.world)
    }
}

/// The fields of the file.
#[derive(Deserialize)]
struct Figures {
    driver: String,
    #[serde(flatten)]
    maps: Maps,
    /// An estimate, or its mean alone in the file of an earlier version.
    strict_success: serde_json::Value,
    failures: Vec<Failure>,
    /// Present where parts of `--shard` are missing.
    missing: Option<serde::de::IgnoredAny>,
}

#[derive(Deserialize)]
struct Failure {
    seed: u64,
    cause: Cause,
}

impl TryFrom<Figures> for Outcomes {
    type Error = anyhow::Error;

    fn try_from(figures: Figures) -> anyhow::Result<Outcomes> {
        ensure!(
            figures.missing.is_none(),
            "parts of it are missing: drive them, then write it with ./vlaps eval --report --json"
        );
        let strict = &figures.strict_success;
        let strict = strict.as_f64().or_else(|| strict["mean"].as_f64());
        let failed = strict.map(|share| (1.0 - share) * figures.maps.episodes as f64);
        let named = figures.failures.len();
        ensure!(
            failed.is_some_and(|failed| (failed - named as f64).abs() < 0.5),
            "its strict success and its {named} failures contradict each other"
        );
        let mut failures = BTreeMap::new();
        for Failure { seed, cause } in figures.failures {
            let is_driven = seed.wrapping_sub(figures.maps.first_seed) < figures.maps.episodes;
            ensure!(is_driven, "the failed seed {seed} is none that was driven");
            ensure!(
                failures.insert(seed, cause).is_none(),
                "seed {seed} failed twice"
            );
        }
        Ok(Outcomes {
            driver: figures.driver,
            maps: figures.maps,
            failures,
        })
    }
}

impl Outcomes {
    /// Those of a JSON object of figures.
    ///
    /// # Errors
    /// If it has other fields, or failures of maps that were not driven.
    pub fn of(figures: &serde_json::Value) -> anyhow::Result<Outcomes> {
        serde_json::from_value::<Figures>(figures.clone())?.try_into()
    }

    /// Those in a file.
    ///
    /// # Errors
    /// If it cannot be read, and as [`Outcomes::of`].
    pub fn read(file: &Path) -> anyhow::Result<Outcomes> {
        let text = shm_config::file::read(file, BYTES_MAX)?;
        let figures: Figures = serde_json::from_slice(&text)
            .context("no figures of ./vlaps eval --json, and no final.json of a training")?;
        figures.try_into()
    }

    /// Refuses other maps than these.
    ///
    /// # Errors
    /// If the seeds, the worlds or their settings differ.
    pub fn check_maps(&self, driven: &Maps) -> anyhow::Result<()> {
        match self.maps.difference(driven) {
            Some(difference) => bail!("it was driven with {difference}"),
            None => Ok(()),
        }
    }

    /// Whether the file tells the settings of its world.
    pub fn tells_settings(&self) -> bool {
        self.maps.settings.is_some()
    }

    /// Whether the episode of a seed succeeded by one of the [`KNOWN`] metrics.
    fn succeeded(&self, metric: Metric, seed: u64) -> bool {
        self.failures
            .get(&seed)
            .is_none_or(|cause| metric == Metric::Success && cause.arrived())
    }
}

/// An evaluation compared with an earlier one on the same maps; the key `against` of
/// `--json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// The earlier evaluation's driver.
    pub driver: String,
    /// Episodes that arrived.
    pub success: Paired,
    /// Episodes that arrived without any contact.
    pub strict_success: Paired,
}

/// In how many episodes one of two drivers alone succeeds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Paired {
    /// Episodes in which this driver succeeds and the earlier one does not.
    pub this_alone: u64,
    /// Episodes in which the earlier driver succeeds and this one does not.
    pub other_alone: u64,
    /// The two-sided p value of the exact sign test.
    pub p: f64,
}

impl Comparison {
    /// Compares two evaluations.
    ///
    /// # Errors
    /// If they drove on other maps or in another world.
    pub fn new(this: &Outcomes, other: &Outcomes) -> anyhow::Result<Comparison> {
        other.check_maps(&this.maps)?;
        let [success, strict_success] = KNOWN.map(|metric| {
            let alone = |one: &Outcomes, two: &Outcomes| {
                let failed = two.failures.keys();
                failed
                    .filter(|seed| one.succeeded(metric, **seed) && !two.succeeded(metric, **seed))
                    .count() as u64
            };
            let (this_alone, other_alone) = (alone(this, other), alone(other, this));
            Paired {
                this_alone,
                other_alone,
                p: sign_test(this_alone, other_alone),
            }
        });
        Ok(Comparison {
            driver: other.driver.clone(),
            success,
            strict_success,
        })
    }

    /// The table.
    pub fn table(&self) -> Table {
        let mut table = table(&["episodes with", "this alone", "the other alone", "p"]);
        for (metric, paired) in KNOWN.iter().zip([self.success, self.strict_success]) {
            table.add_row([
                metric.name().to_string(),
                paired.this_alone.to_string(),
                paired.other_alone.to_string(),
                match paired.p {
                    ..0.0001 => "<0.0001".into(),
                    p => format!("{p:.4}"),
                },
            ]);
        }
        table
    }
}

/// The mean of a [`KNOWN`] metric over trainings on the same maps, and half of its 95 %
/// interval if both are drawn at random; `None` if the maps differ, or with fewer than three
/// trainings.
pub fn over_seeds_and_maps(trainings: &[Outcomes], metric: Metric) -> Option<(f64, f64)> {
    let first = trainings.iter().find(|training| training.tells_settings());
    let maps = &first.or(trainings.first())?.maps;
    let mut others = trainings.iter();
    if others.any(|training| training.maps.difference(maps).is_some()) {
        return None;
    }
    let row = |training: &Outcomes| {
        maps.seeds()
            .map(|seed| f64::from(training.succeeded(metric, seed)))
            .collect()
    };
    over_both(&trainings.iter().map(row).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn outcomes(driver: &str, failures: serde_json::Value) -> Outcomes {
        let failed = failures.as_array().expect("failures").len();
        let figures = json!({
            "driver": driver, "world": "sim", "first_seed": 10, "episodes": 20,
            "strict_success": {"mean": 1.0 - failed as f64 / 20.0}, "failures": failures,
        });
        Outcomes::of(&figures).expect("figures")
    }

    #[test]
    fn maps_on_which_one_alone_succeeds_are_counted() {
        let touched = "arrived, touched a vehicle";
        let this = outcomes(
            "mpc",
            json!([{"seed": 10, "cause": touched}, {"seed": 11, "cause": "max step"}]),
        );
        let other = outcomes(
            "idm",
            json!([
                {"seed": 10, "cause": "out of road"}, {"seed": 12, "cause": touched},
                {"seed": 13, "cause": "out of road"}, {"seed": 29, "cause": "max step"},
            ]),
        );
        let found = Comparison::new(&this, &other).expect("the same maps");
        let of = |paired: Paired| [paired.this_alone, paired.other_alone];
        assert_eq!(of(found.success), [3, 1], "10 13 29, and 11");
        assert_eq!(of(found.strict_success), [3, 1], "12 13 29, and 11");
        assert_eq!(found.driver, "idm");
        let turned = Comparison::new(&other, &this).expect("the same maps");
        assert_eq!(of(turned.success), [1, 3]);
        assert_eq!(turned.success.p, found.success.p);
        assert!(
            found.table().to_string().contains("0.6250"),
            "{}",
            found.table()
        );
    }

    #[test]
    fn other_maps_and_damaged_figures_are_refused() {
        let this = outcomes("mpc", json!([]));
        let mut other = this.clone();
        other.maps.first_seed = 11;
        let error = Comparison::new(&this, &other)
            .expect_err("other maps")
            .to_string();
        assert!(
            error.contains("seeds 11 to 30") && error.contains("seeds 10 to 29"),
            "{error}"
        );
        let with = |blocks: u32| {
            let world = World {
                blocks,
                rate_hz: f64::from(blocks),
                ..World::default()
            };
            let mut outcomes = this.clone();
            outcomes.maps.settings = WorldSettings::of(&world, Simulator::BuiltIn);
            outcomes
        };
        let error = Comparison::new(&with(3), &with(7)).expect_err("other maps");
        assert_eq!(
            error.to_string(),
            "it was driven with world.blocks 7, not 3"
        );
        assert!(Comparison::new(&with(3), &with(3)).is_ok());
        assert!(with(3).tells_settings());
        let other = WorldSettings::of(&World::default(), Simulator::IrSim);
        assert_eq!(other, None, "its courses follow the vehicle");
        // Files of an earlier version have none.
        assert!(Comparison::new(&this, &with(3)).is_ok() && !this.tells_settings());
        let figures = |strict: f64, failures: serde_json::Value| {
            json!({
                "driver": "mpc", "world": "sim", "first_seed": 10, "episodes": 20,
                "strict_success": strict, "failures": failures,
            })
        };
        let late = json!({"seed": 10, "cause": "max step"});
        assert!(Outcomes::of(&figures(0.95, json!([late]))).is_ok());
        for (strict, failures) in [
            (0.95, json!([{"seed": 9, "cause": "max step"}])),
            (0.95, json!([{"seed": 10, "cause": "bad luck"}])),
            (0.9, json!([late, late])),
            (0.95, json!([])),
        ] {
            let figures = figures(strict, failures);
            assert!(Outcomes::of(&figures).is_err(), "{figures}");
        }
        let partial = json!({
            "driver": "mpc", "world": "sim", "first_seed": 10, "episodes": 20, "failures": [],
            "strict_success": 1.0, "missing": {"pieces": 3, "shards": []},
        });
        let error = Outcomes::of(&partial).expect_err("partial").to_string();
        assert!(error.contains("missing"), "{error}");
    }

    #[test]
    fn an_interval_over_maps_is_wider_than_one_over_trainings_that_fail_on_the_same_maps() {
        let same: Vec<Outcomes> = (0..5)
            .map(|_| outcomes("p", json!([{"seed": 10, "cause": "max step"}])))
            .collect();
        let (mean, half) = over_seeds_and_maps(&same, Metric::Success).expect("five trainings");
        assert_eq!(mean, 0.95);
        // One failure in 20 maps; Student's factor with 19 degrees of freedom is 2.093.
        let half_of_share = 2.093 * (0.95f64 * 0.05 / 19.0).sqrt();
        assert!((half - half_of_share).abs() < 1e-4, "{half}");
        assert_eq!(over_seeds_and_maps(&same[..2], Metric::Success), None);
    }
}
