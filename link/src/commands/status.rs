//! `link status`.

use std::io;
use std::path::PathBuf;

use serde_json::Value;
use shm_config::run::RunPaths;

use crate::arguments::LinkStatus;

pub(super) fn status(arguments: &LinkStatus) -> Result<u8, String> {
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
        println!(
            "run '{run}' has no link: neither --judge, --learner, serve nor join; the actors of a \
             training are in seed-0/actors.json of the folder of its --out, once a second"
        );
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
    if report["dropped"].as_u64() > Some(0) {
        println!("  given to no program: {}", report["dropped"]);
    }
    if report["superseded"].as_u64() > Some(0) {
        println!("  replaced by newer ones: {}", report["superseded"]);
    }
    let refused = report["refused"].as_object();
    for (reason, count) in refused.into_iter().flatten() {
        if count.as_u64() > Some(0) {
            println!("  refused {reason}: {count}");
        }
    }
}
