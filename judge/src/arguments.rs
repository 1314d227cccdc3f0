//! Command line of `vlaps-judge`.

use std::time::Duration;

use clap::builder::{PossibleValuesParser, TypedValueParser as _};
use clap::{Args, Parser, Subcommand};
use judge::standin::{Options, ServerFault};

use crate::auditing::{AuditArguments, ReplayArguments};
use crate::distilling::DistilArguments;

/// Audit a judge, ask another model the same questions, distil a judge, or serve a stand-in
#[derive(Debug, Parser)]
#[command(name = "vlaps-judge", bin_name = "./vlaps judge", version)]
pub struct Arguments {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Serve a stand-in for a vision-language model; it is not a model
    ///
    /// For tests and offline work: it speaks the OpenAI-compatible protocol over HTTP
    /// and decides by the colours of the pixels which of the two paths in the picture is
    /// safer. To use it, set vlm.server to http://127.0.0.1:PORT/v1 and vlm.model to
    /// vlaps-stand-in, so that its answers are recorded as those of the stand-in.
    #[command(
        allow_negative_numbers = true,
        after_help = "Examples:\n  \
            ./vlaps judge serve\n  \
            ./vlaps judge serve --port 0 --latency 2 --noise 0.1"
    )]
    Serve(ServeArguments),
    /// Write a page with the questions and answers of a run, and their accuracy
    Audit(AuditArguments),
    /// Ask another model the questions of a run
    Replay(ReplayArguments),
    /// Train a small net on recorded questions, which answers in place of a slow judge
    Distil(DistilArguments),
}

/// How the stand-in behaves.
#[derive(Debug, Args)]
pub struct ServeArguments {
    /// Port on 127.0.0.1; 0 for any free port
    #[arg(long, default_value_t = 8080)]
    pub port: u16,
    /// Delay of each answer, s
    #[arg(long, value_name = "S", default_value = "0", value_parser = seconds)]
    pub latency: Duration,
    /// Maximum additional random delay, s
    #[arg(long, value_name = "S", default_value = "0", value_parser = seconds)]
    pub jitter: Duration,
    /// Share of answers that are inverted
    #[arg(long, value_name = "P", default_value = "0", value_parser = share)]
    pub noise: f64,
    /// Share of answers that are "the first" regardless of the picture
    #[arg(long, value_name = "P", default_value = "0", value_parser = share)]
    pub first_bias: f64,
    /// Share of answers that are "similar" regardless of the picture
    #[arg(long, value_name = "P", default_value = "0", value_parser = share)]
    pub abstain: f64,
    /// Questions accepted per minute; further ones get status 429 with Retry-After
    #[arg(long, value_name = "N/MIN", value_parser = clap::value_parser!(u32).range(1..))]
    pub rate_limit: Option<u32>,
    /// Fault to inject
    #[arg(long, value_name = "NAME", value_parser = server_faults())]
    pub fault: Option<ServerFault>,
    /// Share of questions with the fault
    #[arg(long, value_name = "P", default_value = "1", requires = "fault", value_parser = share)]
    pub fault_share: f64,
    /// Seed of all random draws
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

impl ServeArguments {
    /// The stand-in's options.
    pub fn options(&self) -> Options {
        Options {
            port: self.port,
            latency: self.latency,
            jitter: self.jitter,
            noise: self.noise,
            first_bias: self.first_bias,
            abstain: self.abstain,
            rate_per_minute: self.rate_limit,
            injected: self.fault,
            injected_share: self.fault_share,
            seed: self.seed,
            rater: std::sync::Arc::new(judge::pixels::PixelRules),
        }
    }
}

fn server_faults() -> impl clap::builder::TypedValueParser<Value = ServerFault> {
    let words = ServerFault::ALL.iter().map(|injected| injected.word());
    PossibleValuesParser::new(words).try_map(|word| {
        let mut all = ServerFault::ALL.iter();
        all.find(|injected| injected.word() == word)
            .copied()
            .ok_or("no such fault")
    })
}

pub fn number(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| "must be a number".into())
}

fn seconds(text: &str) -> Result<Duration, String> {
    let seconds = number(text)?;
    match (0.0..=3600.0).contains(&seconds) {
        true => Ok(Duration::from_secs_f64(seconds)),
        false => Err("must lie within 0 and 3600 s".into()),
    }
}

pub fn share(text: &str) -> Result<f64, String> {
    let share = number(text)?;
    match (0.0..=1.0).contains(&share) {
        true => Ok(share),
        false => Err("must be a share within 0 and 1".into()),
    }
}
