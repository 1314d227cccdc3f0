//! The command line of `vlaps-judge`.

use std::time::Duration;

use clap::builder::{PossibleValuesParser, TypedValueParser as _};
use clap::{Args, Parser, Subcommand};
use judge::standin::{Mishap, Options};

use crate::auditing::{AuditArguments, ReplayArguments};

/// Audit a judge, ask another the same, or serve a stand-in for a model
#[derive(Debug, Parser)]
#[command(name = "vlaps-judge", bin_name = "./vlaps judge", version)]
pub struct Arguments {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Serve a stand-in for a vision-language model; it is no model
    ///
    /// For tests and offline work: it speaks the OpenAI-compatible protocol over
    /// HTTP, and judges by coloured pixels alone which of the two paths in the
    /// picture is safer. Set vlm.server to http://127.0.0.1:PORT/v1 to have it
    /// asked, and vlm.model to vlaps-stand-in to have it counted as what it is.
    #[command(
        allow_negative_numbers = true,
        after_help = "Examples:\n  \
            ./vlaps judge serve\n  \
            ./vlaps judge serve --port 0 --latency 2 --noise 0.1"
    )]
    Serve(ServeArguments),
    /// Make a page of what a judge was asked in a run, and how right it was
    Audit(AuditArguments),
    /// Ask another model what a judge was asked in a run
    Replay(ReplayArguments),
}

/// How the stand-in behaves.
#[derive(Debug, Args)]
pub struct ServeArguments {
    /// Where to listen, on this machine alone; 0 for any free port
    #[arg(long, default_value_t = 8080)]
    pub port: u16,
    /// Time until it answers, s
    #[arg(long, value_name = "S", default_value = "0", value_parser = seconds)]
    pub latency: Duration,
    /// Up to so much longer, at random, s
    #[arg(long, value_name = "S", default_value = "0", value_parser = seconds)]
    pub jitter: Duration,
    /// Share of its answers that are turned round
    #[arg(long, value_name = "P", default_value = "0", value_parser = share)]
    pub noise: f64,
    /// Share of its answers that are "the first" regardless of the picture
    #[arg(long, value_name = "P", default_value = "0", value_parser = share)]
    pub first_bias: f64,
    /// Share of its answers that are "similar" regardless of the picture
    #[arg(long, value_name = "P", default_value = "0", value_parser = share)]
    pub abstain: f64,
    /// Questions it takes in any minute; beyond that it says 429 with Retry-After
    #[arg(long, value_name = "N/MIN", value_parser = clap::value_parser!(u32).range(1..))]
    pub rate_limit: Option<u32>,
    /// How it breaks
    #[arg(long, value_name = "NAME", value_parser = mishaps())]
    pub fault: Option<Mishap>,
    /// Share of the questions it breaks at
    #[arg(long, value_name = "P", default_value = "1", requires = "fault", value_parser = share)]
    pub fault_share: f64,
    /// What is drawn at random
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

impl ServeArguments {
    /// As the stand-in takes them.
    pub fn options(&self) -> Options {
        Options {
            port: self.port,
            latency: self.latency,
            jitter: self.jitter,
            noise: self.noise,
            first_bias: self.first_bias,
            abstain: self.abstain,
            rate_per_minute: self.rate_limit,
            mishap: self.fault,
            mishap_share: self.fault_share,
            seed: self.seed,
            eyes: std::sync::Arc::new(judge::eyes::Sighted),
        }
    }
}

fn mishaps() -> impl clap::builder::TypedValueParser<Value = Mishap> {
    let words = Mishap::ALL.iter().map(|mishap| mishap.word());
    PossibleValuesParser::new(words).try_map(|word| {
        let mut all = Mishap::ALL.iter();
        all.find(|mishap| mishap.word() == word)
            .copied()
            .ok_or("no such fault")
    })
}

fn number(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| "must be a number".into())
}

fn seconds(text: &str) -> Result<Duration, String> {
    let seconds = number(text)?;
    match (0.0..=3600.0).contains(&seconds) {
        true => Ok(Duration::from_secs_f64(seconds)),
        false => Err("must lie within 0 and 3600 s".into()),
    }
}

fn share(text: &str) -> Result<f64, String> {
    let share = number(text)?;
    match (0.0..=1.0).contains(&share) {
        true => Ok(share),
        false => Err("must be a share within 0 and 1".into()),
    }
}
