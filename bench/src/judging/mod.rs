//! Accuracy of a judge, over HTTP, on scenes whose answer the simulator knows; the
//! effect of a bias towards the first path, and how asking twice with swapped paths
//! reduces it.

mod arguments;
pub mod distilled;
pub mod evaluation;
pub mod scenes;

use std::process::ExitCode;
use std::sync::Arc;
use supervisor::subcommand::{Output, Subcommand};

use anyhow::{Context, bail};
use indicatif::{ProgressBar, ProgressStyle};
use judge::standin::{Options, Server};
use judge::statistics::Share;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;
use serde::Serialize;
use shm_config::config::{Config, STAND_IN, View, Vlm};
use shm_config::counted;

pub use arguments::{BenchJudge, Views};
use distilled::{Distilled, Meter};
use evaluation::{Evaluation, ONCE, Row};
use lab::report::{Machine, table};
use scenes::{Search, search};
use stack::Clock;
use supervisor::subcommand::settings;
use supervisor::subcommand::{say, write_json};

/// The object of `--json`.
#[derive(Debug, Serialize)]
struct Rows<'a> {
    rows: &'a [Row],
    #[serde(skip_serializing_if = "Option::is_none")]
    distilled: Option<&'a Distilled>,
    conditions: Conditions,
}

#[derive(Debug, Serialize)]
struct Conditions {
    scenes: u32,
    first_seed: u64,
    horizon_s: f64,
    width_px: u32,
    height_px: u32,
    machine: Machine,
}

impl Subcommand for BenchJudge {
    fn outputs(&self) -> Vec<Output> {
        vec![
            Output::Folder("--record", self.record.clone()),
            Output::json(&self.json),
        ]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let chosen = &self.configuration;
        // Checked as every other address of the configuration.
        let server = self.server.iter();
        let server = server.map(|url| format!("vlm.server={url}"));
        let overrides: Vec<_> = chosen.overrides.iter().cloned().chain(server).collect();
        let config = settings::config(
            [chosen.config.as_deref(), chosen.vehicle.as_deref()],
            &overrides,
        )?;
        let machine = Machine::here()?;
        let bar = ProgressBar::new(u64::from(self.scenes));
        let style = "{elapsed_precise} {wide_bar} {pos}/{len} scenes, {eta} left";
        bar.set_style(ProgressStyle::with_template(style)?);
        let net = self.net.as_ref();
        let net = net.map(|path| Meter::open(path, config.vehicle, clock));
        let mut net = net.transpose()?;
        let rows = measure(self, &config, (clock, net.as_mut()), || bar.inc(1))?;
        bar.finish_and_clear();
        if rows.iter().all(Row::is_unanswered) {
            bail!(
                "no answer to any of {}{}",
                counted(u64::from(self.scenes), "scene"),
                reasons(&rows)
            );
        }
        print(&rows);
        if self.server.is_none() {
            say("The stand-in is not a model: it judges by the colours of the pixels.");
        }
        let distilled = net.map(|net| net.figures());
        distilled.iter().for_each(distilled::print);
        let Some(path) = &self.json else {
            return Ok(ExitCode::SUCCESS);
        };
        let conditions = Conditions {
            scenes: self.scenes,
            first_seed: self.first_seed,
            horizon_s: sim::render_thread::HORIZON_S,
            width_px: config.vlm.width_px,
            height_px: config.vlm.height_px,
            machine,
        };
        write_json(
            path,
            &Rows {
                rows: &rows,
                distilled: distilled.as_ref(),
                conditions,
            },
        )?;
        Ok(ExitCode::SUCCESS)
    }
}

/// Measures the rows of the table: for each view and server, asked once and twice.
///
/// # Errors
/// As [`bench`].
pub fn measure(
    arguments: &BenchJudge,
    config: &Config,
    (clock, mut net): (Clock, Option<&mut Meter>),
    asked: impl Fn(),
) -> anyhow::Result<Vec<Row>> {
    let views: &[View] = match arguments.view {
        Views::Ego => &[View::Ego],
        Views::TopDown => &[View::TopDown],
        Views::Both => &[View::TopDown, View::Ego],
    };
    let judges = judges(arguments)?;
    let names = &judges.names;
    let mut evaluations = Vec::new();
    for (number, &view) in views.iter().enumerate() {
        for (name, url) in names {
            // Each folder holds the record of one judge.
            let record = arguments.record.as_ref();
            let folder = record.map(|folder| match (views.len(), names.len()) {
                (1, 1) => folder.clone(),
                _ => folder.join(format!(
                    "{}-{}",
                    evaluation::view_word(view),
                    name.replace(", ", "-").replace(' ', "-")
                )),
            });
            let vlm = vlm(arguments, config, url, view);
            let bounds = (number, folder.as_deref());
            evaluations.push(Evaluation::open((name, vlm), config.vehicle, bounds)?);
        }
    }
    let wanted = Search {
        scenes: arguments.scenes as usize,
        first_seed: arguments.first_seed,
        views: &views.iter().map(|&view| view.into()).collect::<Vec<_>>(),
        size_px: [config.vlm.width_px, config.vlm.height_px],
    };
    // All servers see the same path order and colours.
    let mut chance = Xoshiro256PlusPlus::seed_from_u64(arguments.first_seed);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    search(&wanted, config, clock, |scene| {
        let showing = evaluation::showing(&mut chance);
        if let Some(net) = &mut net {
            net.ask(&scene);
        }
        for evaluation in &mut evaluations {
            runtime.block_on(evaluation.ask(&scene, showing))?;
        }
        asked();
        Ok(())
    })?;
    Ok(evaluations.into_iter().flat_map(Evaluation::rows).collect())
}

/// The servers to ask.
struct Judges {
    /// Built-in servers; they run until this value is dropped.
    _servers: Vec<Server>,
    /// Name and address of each server.
    names: Vec<(String, String)>,
}

fn judges(arguments: &BenchJudge) -> anyhow::Result<Judges> {
    if let Some(url) = &arguments.server {
        return Ok(Judges {
            _servers: Vec::new(),
            names: vec![("server".into(), url.clone())],
        });
    }
    let mut servers = Vec::new();
    let mut names = Vec::new();
    for share in [0.5, arguments.bias] {
        // A fixed share of the answers is "the first"; of the others, half are.
        let first_bias = 2.0 * share - 1.0;
        let options = Options {
            first_bias,
            seed: arguments.first_seed,
            rater: Arc::new(judge::pixels::PixelRules),
            ..Options::default()
        };
        let server = Server::start(options).context("no port for the stand-in")?;
        let name = match first_bias == 0.0 {
            true => "stand-in".into(),
            false => format!("stand-in, bias {share}"),
        };
        names.push((name, server.url()));
        servers.push(server);
    }
    Ok(Judges {
        _servers: servers,
        names,
    })
}

/// The configuration for asking one server.
fn vlm(arguments: &BenchJudge, config: &Config, url: &str, view: View) -> Vlm {
    let mut vlm = Vlm {
        server: url.into(),
        view,
        ..config.vlm.clone()
    };
    if arguments.server.is_none() {
        // A stand-in is free and serves this program alone.
        vlm.model = STAND_IN.into();
        vlm.per_minute_max = 10_000;
        (vlm.price_in_usd, vlm.price_out_usd) = (0.0, 0.0);
    }
    vlm
}

fn print(rows: &[Row]) {
    let header = [
        "view",
        "judge",
        "asked",
        "right of preferences",
        "95 %",
        "right of all",
        "kappa",
        "for the first place",
        "95 %",
        "no preference",
    ];
    let mut table = table(&header);
    for row in rows {
        table.add_row([
            row.view.to_string(),
            row.judge.clone(),
            row.asked.to_string(),
            percent(row.right_of_preferences),
            interval(row.right_of_preferences),
            percent(row.right_of_all),
            row.kappa.map_or("-".into(), |kappa| format!("{kappa:.2}")),
            percent(row.first_place),
            interval(row.first_place),
            (row.similar + row.abstained + row.failed).to_string(),
        ]);
    }
    say(table);
}

/// The reasons for missing answers, from the rows that were asked once.
fn reasons(rows: &[Row]) -> String {
    let once = rows.iter().filter(|row| row.asked == ONCE);
    let texts = once.map(|row| {
        let faults = row.faults.iter();
        let faults: Vec<_> = faults
            .map(|(word, count)| format!("{count} {word}"))
            .collect();
        format!("; {}: {}", row.view, faults.join(", "))
    });
    texts.collect()
}

/// In per cent; "-" if nothing was counted.
fn percent(share: Share) -> String {
    match share.trials {
        0 => "-".into(),
        _ => format!("{:.1} %", 100.0 * share.mean()),
    }
}

/// The 95 % confidence interval in per cent; "-" if nothing was counted.
fn interval(share: Share) -> String {
    let [low, high] = share.interval().map(|end| 100.0 * end);
    match share.trials {
        0 => "-".into(),
        _ => format!("{low:.1} to {high:.1}"),
    }
}
