//! How often a judge is right, over HTTP, on scenes where the simulator knows;
//! what a preference for the first place does to it, and what asking twice does
//! against that.

mod arguments;
pub mod court;
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
use court::{Court, ONCE, Row};
use lab::report::{Machine, table};
use scenes::{Search, search};
use stack::Clock;
use supervisor::subcommand::settings;
use supervisor::subcommand::{say, write_json};

/// The object of `--json`.
#[derive(Debug, Serialize)]
struct Rows<'a> {
    rows: &'a [Row],
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
        // Checked like any other address.
        let server = self.server.iter();
        let server = server.map(|url| format!("vlm.server={url}"));
        let overrides: Vec<_> = chosen.overrides.iter().cloned().chain(server).collect();
        let config = settings::config(chosen.config.as_deref(), &overrides)?;
        let machine = Machine::here()?;
        let bar = ProgressBar::new(u64::from(self.scenes));
        let style = "{elapsed_precise} {wide_bar} {pos}/{len} scenes, {eta} left";
        bar.set_style(ProgressStyle::with_template(style)?);
        let rows = measure(self, &config, clock, || bar.inc(1))?;
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
            say("The stand-in is no model: it judges from coloured pixels.");
        }
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
                conditions,
            },
        )?;
        Ok(ExitCode::SUCCESS)
    }
}

/// The rows of the table: for each view and server, asked once and twice.
///
/// # Errors
/// As [`bench`].
pub fn measure(
    arguments: &BenchJudge,
    config: &Config,
    clock: Clock,
    asked: impl Fn(),
) -> anyhow::Result<Vec<Row>> {
    let views: &[View] = match arguments.view {
        Views::Ego => &[View::Ego],
        Views::TopDown => &[View::TopDown],
        Views::Both => &[View::TopDown, View::Ego],
    };
    let panel = panel(arguments)?;
    let names = &panel.names;
    let mut courts = Vec::new();
    for (number, &view) in views.iter().enumerate() {
        for (name, url) in names {
            // One folder holds one judge's record.
            let record = arguments.record.as_ref();
            let folder = record.map(|folder| match (views.len(), names.len()) {
                (1, 1) => folder.clone(),
                _ => folder.join(format!(
                    "{}-{}",
                    court::view_word(view),
                    name.replace(", ", "-").replace(' ', "-")
                )),
            });
            let vlm = vlm(arguments, config, url, view);
            let bounds = (number, folder.as_deref());
            courts.push(Court::open((name, vlm), config.vehicle, bounds)?);
        }
    }
    let wanted = Search {
        scenes: arguments.scenes as usize,
        first_seed: arguments.first_seed,
        views: &views.iter().map(|&view| view.into()).collect::<Vec<_>>(),
        size_px: [config.vlm.width_px, config.vlm.height_px],
    };
    // The same places and colours for all servers.
    let mut chance = Xoshiro256PlusPlus::seed_from_u64(arguments.first_seed);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    search(&wanted, config, clock, |scene| {
        let showing = court::showing(&mut chance);
        for court in &mut courts {
            runtime.block_on(court.hear(&scene, showing))?;
        }
        asked();
        Ok(())
    })?;
    Ok(courts.into_iter().flat_map(Court::rows).collect())
}

/// Whom to ask.
struct Panel {
    /// Those that run here, as long as this lives.
    _servers: Vec<Server>,
    /// All of them: name and address.
    names: Vec<(String, String)>,
}

fn panel(arguments: &BenchJudge) -> anyhow::Result<Panel> {
    if let Some(url) = &arguments.server {
        return Ok(Panel {
            _servers: Vec::new(),
            names: vec![("server".into(), url.clone())],
        });
    }
    let mut servers = Vec::new();
    let mut names = Vec::new();
    for share in [0.5, arguments.bias] {
        // So many answers are "the first" regardless; of the others half are.
        let first_bias = 2.0 * share - 1.0;
        let options = Options {
            first_bias,
            seed: arguments.first_seed,
            eyes: Arc::new(judge::eyes::Sighted),
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
    Ok(Panel {
        _servers: servers,
        names,
    })
}

/// The configuration that a server is asked by.
fn vlm(arguments: &BenchJudge, config: &Config, url: &str, view: View) -> Vlm {
    let mut vlm = Vlm {
        server: url.into(),
        view,
        ..config.vlm.clone()
    };
    if arguments.server.is_none() {
        // A stand-in charges nothing and serves this program alone.
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
            row.who.clone(),
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

/// Why there are no answers, as each view was asked once.
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

/// In per cent; a dash of nothing.
fn percent(share: Share) -> String {
    match share.trials {
        0 => "-".into(),
        _ => format!("{:.1} %", 100.0 * share.mean()),
    }
}

/// Its 95 % interval; a dash of nothing.
fn interval(share: Share) -> String {
    let [low, high] = share.interval().map(|end| 100.0 * end);
    match share.trials {
        0 => "-".into(),
        _ => format!("{low:.1} to {high:.1}"),
    }
}
