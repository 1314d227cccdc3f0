//! `vlaps-link`: `./vlaps link` and `./vlaps join`.

use std::io;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use arguments::{Invite, Join, Link, LinkCommand, LinkStatus, Revoke, Serve, address};
use clap::{Parser, Subcommand};
use serde_json::Value;
use shm_config::config::{Config, load};
use shm_config::run::RunPaths;
use shm_config::secret;
use shm_config::text::{Printable, printable_lines};
use vlaps_link::join::{Options, join};
use vlaps_link::keys::{Bundle, Identity, RunKeys, folder};
use vlaps_link::role::Role;
use vlaps_link::serve::serve;
use vlaps_link::stand_in::clocks;

#[path = "../../supervisor/src/commands/link.rs"]
mod arguments;

/// Judge, learner, view and recorder of a set on other machines.
#[derive(Parser)]
#[command(name = "vlaps", bin_name = "./vlaps", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Other machines.
    Link(Link),
    /// Join a set that drives on another machine.
    Join(Join),
}

fn role(word: &str) -> Result<Role, String> {
    Role::from_word(word).ok_or_else(|| format!("there is no role {word}"))
}

fn main() -> ExitCode {
    // Done before the first thread starts; a judge's key goes to the gate alone.
    let taken = secret::take().map_err(|error| format!("the keys of the environment: {error}"));
    let command = Cli::parse().command;
    tracing_subscriber::fmt()
        .with_writer(|| Printable(io::stderr()))
        .with_ansi(false)
        .with_target(false)
        // Zenoh's own lines repeat with each attempt to connect.
        .with_env_filter("info,zenoh=off")
        .init();
    let done = taken.and_then(|()| match command {
        Command::Link(Link { command }) => match &command {
            LinkCommand::Invite(arguments) => invite(arguments),
            LinkCommand::Revoke(arguments) => revoke(arguments),
            LinkCommand::Serve(arguments) => serve_run(arguments),
            LinkCommand::Status(arguments) => status(arguments),
        },
        Command::Join(arguments) => join_run(&arguments),
    });
    match done {
        Ok(code) => ExitCode::from(code),
        Err(line) => {
            eprintln!("vlaps-link: {}", printable_lines(&line));
            ExitCode::from(2)
        }
    }
}

fn stop_flag() -> Result<Arc<AtomicBool>, String> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        let registered = signal_hook::flag::register(signal, stop.clone());
        registered.map_err(|error| format!("cannot handle signals: {error}"))?;
    }
    Ok(stop)
}

fn invite(arguments: &Invite) -> Result<u8, String> {
    let Invite { run, .. } = arguments;
    let role = role(&arguments.role)?;
    let failed = |error: io::Error| error.to_string();
    let keys = match RunKeys::read(run).map_err(failed)? {
        Some(keys) => keys,
        None => {
            let keys = RunKeys::make(&run.to_string()).map_err(failed)?;
            keys.write(run).map_err(failed)?;
            let folder = folder().map_err(failed)?;
            println!("made the keys of run '{run}' in {}", folder.display());
            keys
        }
    };
    let expires_epoch_s = clocks().1 + arguments.hours * 3600;
    let bundle = keys
        .invite(role, &arguments.address, expires_epoch_s)
        .map_err(failed)?;
    let out = arguments.out.display();
    bundle
        .write(&arguments.out)
        .map_err(|error| format!("{out}: {error}; choose a name that no file has"))?;
    let (peer, hours) = (bundle.peer, arguments.hours);
    println!(
        "{out}: an invitation for one {role}, {hours} h, peer {peer}\n\
         it holds a key: carry it as a secret, then on the other machine ./vlaps join {out}\n\
         to end it: ./vlaps link revoke --run {run} {peer}"
    );
    Ok(0)
}

fn revoke(arguments: &Revoke) -> Result<u8, String> {
    let Revoke { run, peer } = arguments;
    let failed = |error: io::Error| error.to_string();
    let peer = Identity::try_from(peer.clone())?;
    let keys = RunKeys::read(run).map_err(failed)?;
    let mut keys = keys.ok_or_else(|| format!("run '{run}' has invited no peer"))?;
    if !keys.revoked.contains(&peer) {
        keys.revoked.push(peer);
        keys.write(run).map_err(failed)?;
    }
    println!("peer {peer} has no effect on run '{run}' any more");
    Ok(0)
}

fn serve_run(arguments: &Serve) -> Result<u8, String> {
    let stop = stop_flag()?;
    serve(&arguments.run, &arguments.listen, &stop).map(|()| 0)
}

fn status(arguments: &LinkStatus) -> Result<u8, String> {
    let run = &arguments.run;
    let origin = RunPaths::new(run.clone()).origin();
    let folder = origin.map_or(PathBuf::from(format!("runs/{run}")), |origin| origin.folder);
    let mut all = serde_json::Map::new();
    for name in ["judge", "learner", "readers", "join"] {
        let path = folder.join(format!("link-{name}.json"));
        match shm_config::file::read_text(&path, 1 << 20) {
            Ok(text) => {
                let report: Value = serde_json::from_str(&text)
                    .map_err(|error| format!("{}: {error}", path.display()))?;
                print_report(name, &report);
                all.insert(name.into(), report);
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(format!("{}: {error}", path.display())),
        }
    }
    if let Some(path) = &arguments.json {
        let text = serde_json::to_string_pretty(&all).map_err(|error| error.to_string())?;
        std::fs::write(path, text + "\n")
            .map_err(|error| format!("{}: {error}", path.display()))?;
    }
    if all.is_empty() {
        println!("run '{run}' has no link: neither --judge, --learner, serve nor join");
        return Ok(1);
    }
    Ok(0)
}

fn print_report(name: &str, report: &Value) {
    println!("{name} at {}", report["address"].as_str().unwrap_or("?"));
    let none = Vec::new();
    let peers = report["peers"].as_array().unwrap_or(&none);
    let own = (name == "join").then_some(report);
    for peer in peers.iter().chain(own) {
        let session = &peer["session"];
        let state = match session["is_joined"].as_bool() {
            Some(true) => "joined",
            _ => "not here",
        };
        let who = peer["peer"].as_str().unwrap_or("the vehicle");
        let role = peer["role"].as_str().unwrap_or("?");
        println!("  {role} {who}: {state}, sessions {}", session["sessions"]);
        if let Some(clock) = session["clock"].as_object() {
            let number = |key: &str| clock[key].as_f64().unwrap_or(f64::NAN);
            println!(
                "    clock ahead {:.3} ms +- {:.3}, round trip {:.3} ms, jumps {}",
                number("ahead_ms"),
                number("uncertainty_ms"),
                number("round_trip_ms"),
                clock["jumps"]
            );
        }
        for (row, counts) in peer["rows"].as_object().into_iter().flatten() {
            println!("    {row}: {counts}");
        }
    }
    let refused = report["refused"].as_object();
    for (reason, count) in refused.into_iter().flatten() {
        if count.as_u64() > Some(0) {
            println!("  refused {reason}: {count}");
        }
    }
}

fn join_run(arguments: &Join) -> Result<u8, String> {
    let (path, target) = match (arguments.target.split_once('@'), &arguments.bundle) {
        (Some((run, at)), Some(bundle)) => (bundle.clone(), Some((run, at))),
        (None, None) => (PathBuf::from(&arguments.target), None),
        (Some(_), None) => return Err("RUN@HOST:PORT needs --bundle FILE, the invitation".into()),
        (None, Some(_)) => {
            return Err(
                "name the invitation once: as the argument, or RUN@HOST:PORT with --bundle".into(),
            );
        }
    };
    let bundle = Bundle::read(&path).map_err(|error| error.to_string())?;
    let invited = bundle.role().map_err(|error| error.to_string())?;
    if arguments
        .role
        .as_ref()
        .is_some_and(|role| role != invited.word())
    {
        return Err(format!("{}: is an invitation as {invited}", path.display()));
    }
    if let Some((run, _)) = target.filter(|(run, _)| *run != bundle.run) {
        let (path, own) = (path.display(), &bundle.run);
        return Err(format!(
            "{path}: is an invitation of run '{own}', not of '{run}'"
        ));
    }
    let at = target.map_or(Ok(bundle.address.clone()), |(_, at)| address(at))?;
    let name = match &arguments.run {
        Some(name) => name.clone(),
        None => {
            let name = format!("{}-{invited}", bundle.run);
            name.parse()
                .map_err(|error| format!("{error}; choose one with --run NAME"))?
        }
    };
    let own = match &arguments.config {
        Some(path) => load(path).map_err(|error| error.to_string())?,
        None => Config::default(),
    };
    let key = secret::take_named(&own.vlm.key_env);
    key.map_err(|error| format!("the keys of the environment: {error}"))?;
    let stop = stop_flag()?;
    let options = Options {
        bundle,
        address: at,
        name,
        own,
    };
    join(&options, &stop).map(|()| 0)
}
