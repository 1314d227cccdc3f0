//! `./vlaps export`: a recording as an animation, as tables, or as a dataset.
//!
//! | module | holds |
//! |---|---|
//! | [`course`] | which ticks of a recording are drawn, and which driver drove when |
//! | [`animation`] | the drive from above as an animated PNG |
//! | [`tables`] | tables and datasets, which the Python package writes |

pub mod animation;
pub mod course;
pub mod tables;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, ValueEnum};
use stack::Clock;
use supervisor::cli::failure::Failure;
use supervisor::subcommand::{Output, Subcommand};

use crate::fork::cannot;

/// Sides of a picture, px.
const SIDES_PX: std::ops::RangeInclusive<u32> = 64..=4096;

/// Export a recording: an animation, tables, or a dataset of episodes.
#[derive(Debug, Args)]
#[command(
    after_help = "The animation is an animated PNG, which browsers and GitHub play; it needs no \
        display. The world is rebuilt from the recorded seed and commands; of a world other \
        than the built-in one the road is drawn as the planner understood it. The band shows \
        which driver drove when.\n\n\
        Tables and datasets are written by the Python package: run ./vlaps setup python and \
        target/python/bin/python -m pip install pyarrow (or minari, or pyarrow pandas) once.\n\n\
        A file is complete or not there: it gets its name when it is whole.\n\n\
        Exit code 2: the recording cannot be read, or an option does not fit it.\n\n\
        Examples:\n  \
        ./vlaps export REC                                   REC.png, the whole drive\n  \
        ./vlaps export REC --out drive.png --from 10 --to 40 --speed 4\n  \
        ./vlaps export REC --format parquet --topic step --out tables\n  \
        ./vlaps export REC --format minari --out drives/takeovers-v0\n  \
        ./vlaps export REC --format lerobot --out takeovers"
)]
pub struct Export {
    /// The recording: a folder with the MCAP files of one run, or one file.
    #[arg(value_name = "REC")]
    pub recording: PathBuf,
    /// What to write.
    #[arg(long, value_name = "FORMAT", value_enum, default_value_t = Format::Animation)]
    pub format: Format,
    /// The animation's file, ending in .png; the folder of tables or of LeRobot's dataset; the
    /// name of Minari's. Without it a name made of the recording's.
    #[arg(long, value_name = "OUT")]
    pub out: Option<PathBuf>,
    /// Begin so many seconds after the recording's beginning.
    #[arg(long, value_name = "S", default_value_t = 0.0, allow_negative_numbers = true,
          value_parser = within(0.0, 1e9))]
    pub from: f64,
    /// End there; without it at the recording's end.
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = within(0.0, 1e9))]
    pub to: Option<f64>,
    /// Size of the animation, px.
    #[arg(long, value_name = "WxH", default_value = "720x405", value_parser = size)]
    pub size: [u32; 2],
    /// Metres from its left to its right edge.
    #[arg(long, value_name = "M", default_value_t = 90.0, allow_negative_numbers = true,
          value_parser = within(10.0, 10_000.0))]
    pub across: f64,
    /// How many times faster than driven it plays.
    #[arg(long, value_name = "X", default_value_t = 4.0, allow_negative_numbers = true,
          value_parser = within(0.05, 100.0))]
    pub speed: f64,
    /// Pictures per second of the animation.
    #[arg(long, value_name = "N", default_value_t = 10.0, allow_negative_numbers = true,
          value_parser = within(1.0, 60.0))]
    pub fps: f64,
    /// A table for this topic, such as step; repeatable; without it for every topic.
    #[arg(long = "topic", value_name = "TOPIC")]
    pub topics: Vec<String>,
}

/// What a recording becomes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// The drive from above as an animated PNG.
    Animation,
    /// A Parquet file for each topic; needs pyarrow.
    Parquet,
    /// An Arrow file for each topic; needs pyarrow.
    Arrow,
    /// The episodes with actions and takeovers as a dataset of Minari.
    Minari,
    /// The same as a dataset of LeRobot, version 3.0; needs pyarrow and pandas.
    Lerobot,
}

/// Parses a number within bounds.
fn within(least: f64, most: f64) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync {
    move |text| match text.parse() {
        Ok(value) if (least..=most).contains(&value) => Ok(value),
        _ => Err(format!("must be a number from {least} to {most}")),
    }
}

/// Parses a size such as 720x405.
fn size(text: &str) -> Result<[u32; 2], String> {
    let sides = text.split_once(['x', 'X']);
    let side = |text: &str| text.parse().ok().filter(|side| SIDES_PX.contains(side));
    let parsed = sides.and_then(|(width, height)| Some([side(width)?, side(height)?]));
    parsed.ok_or_else(|| {
        let (least, most) = (SIDES_PX.start(), SIDES_PX.end());
        format!("must be WIDTHxHEIGHT, such as 720x405, each from {least} to {most} pixels")
    })
}

impl Subcommand for Export {
    fn outputs(&self) -> Vec<Output> {
        match self.format {
            Format::Animation => vec![Output::File("--out", self.out.clone())],
            // Python checks its own: a dataset's name is no path.
            Format::Parquet | Format::Arrow | Format::Minari | Format::Lerobot => Vec::new(),
        }
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let done = match self.format {
            Format::Animation => animation::export(self, clock).map(|()| ExitCode::SUCCESS),
            Format::Parquet | Format::Arrow | Format::Minari | Format::Lerobot => {
                tables::export(self)
            }
        };
        done.map_err(cannot)
    }
}

impl Export {
    /// The animation's file.
    fn animation_file(&self) -> anyhow::Result<PathBuf> {
        let default = || {
            let name = self.recording.file_stem().unwrap_or_default();
            Path::new(name).with_extension("png")
        };
        let file = self.out.clone().unwrap_or_else(default);
        let ending = file.extension().map(|ending| ending.to_ascii_lowercase());
        match ending.is_some_and(|ending| ending == "png" || ending == "apng") {
            true => Ok(file),
            false => Err(Failure::Usage(format!(
                "--out {}: the animation is an animated PNG; its name must end in .png",
                file.display()
            ))
            .into()),
        }
    }
}
