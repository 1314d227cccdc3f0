use std::path::PathBuf;

use clap::Args;

use supervisor::subcommand::Configuration;

/// Measure how often a judge is right on scenes whose answer the simulator knows.
#[derive(Debug, Args)]
#[command(
    after_help = "A scene is a moment of the expert's drives in the built-in world in which exactly \
        one of two proposals, held for 3 s, ends in a contact or off the road. The judge is asked \
        over HTTP. Without --server, the built-in stand-in of ./vlaps judge serve is measured; it is \
        not a model, it judges by the colours of the pixels. A second stand-in prefers the first \
        path in a share of --bias of all pairs, as small models do.\n\n\
        Examples:\n  \
        ./vlaps bench judge --json judge.json\n  \
        ./vlaps bench judge --scenes 500 --view top_down\n  \
        ./vlaps bench judge --net judge.onnx\n  \
        ./vlaps bench judge --server http://127.0.0.1:8080/v1 --set vlm.price_in_usd=0 --set vlm.price_out_usd=0"
)]
pub struct BenchJudge {
    /// Number of scenes.
    #[arg(long, value_name = "N", default_value_t = 200,
          value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub scenes: u32,
    /// Seed of the first episode; each following episode adds one.
    #[arg(long, value_name = "N", default_value_t = 1000)]
    pub first_seed: u64,
    /// Camera of the scenes: ego, top_down, or both.
    #[arg(long, value_name = "VIEW", default_value = "both")]
    pub view: Views,
    /// Share of pairs in which the biased stand-in prefers the first path when the
    /// pixels favour neither.
    #[arg(long, value_name = "SHARE", default_value_t = 0.72, value_parser = bias)]
    pub bias: f64,
    /// Measure this server instead of the stand-ins; section vlm holds its other settings.
    #[arg(long, value_name = "URL", conflicts_with = "bias")]
    pub server: Option<String>,
    /// Also ask this distilled judge, and measure how long an answer takes.
    #[arg(long, value_name = "FILE.onnx")]
    pub net: Option<PathBuf>,
    /// Record questions and pictures into this folder, for ./vlaps judge audit.
    #[arg(long, value_name = "DIR")]
    pub record: Option<PathBuf>,
    /// Configuration and overrides.
    #[command(flatten)]
    pub configuration: Configuration,
    /// Also write the rows to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Camera of the scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Views {
    /// From the car.
    #[value(name = "ego")]
    Ego,
    /// From above.
    #[value(name = "top_down")]
    TopDown,
    /// Both, one after the other.
    #[value(name = "both")]
    Both,
}

fn bias(text: &str) -> Result<f64, String> {
    let share: f64 = text.parse().map_err(|_| "must be a number".to_string())?;
    match (0.5..1.0).contains(&share) {
        true => Ok(share),
        false => Err("must be a share from 0.5, which is no bias, to below 1".into()),
    }
}
