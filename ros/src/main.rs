//! `vlaps-ros`: a running set as ROS 2 topics.

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use shm_config::run::RunName;
use shm_config::secret;
use shm_config::text::{Printable, printable_lines};
use vlaps_ros::bridge;
use vlaps_ros::settings::Settings;

const HELP: &str =
    "Publish a running set as ROS 2 topics over Zenoh, as one reader more, until the \
set ends or Ctrl-C.

Usage: vlaps-ros RUN

The environment variable VLAPS_ROS names a file of settings: docs/ros.md.
Exit code 2: no such run, or the settings are wrong.";

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [word] = words.as_slice() else {
        eprintln!("{HELP}");
        return ExitCode::from(2);
    };
    if ["-h", "--help"].contains(&word.as_str()) {
        println!("{HELP}");
        return ExitCode::SUCCESS;
    }
    // It needs no key, and talks to a network.
    if let Err(error) = secret::take() {
        eprintln!("vlaps-ros: cannot take the keys out of the environment: {error}");
        return ExitCode::from(2);
    }
    tracing_subscriber::fmt()
        .with_writer(|| Printable(std::io::stderr()))
        .with_ansi(false)
        .with_target(false)
        // Zenoh's own lines repeat with each attempt to connect.
        .with_env_filter("info,zenoh=off")
        .init();
    match publish(word) {
        Ok(sent) => {
            let (messages, refused) = (sent.messages, sent.refused);
            println!("{messages} messages sent, {refused} refused");
            ExitCode::SUCCESS
        }
        Err(line) => {
            eprintln!("vlaps-ros: {}", printable_lines(&line));
            ExitCode::from(2)
        }
    }
}

fn publish(word: &str) -> Result<bridge::Sent, String> {
    let name: RunName = word.parse().map_err(|error| format!("{error}"))?;
    let settings = Settings::load()?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        let registered = signal_hook::flag::register(signal, stop.clone());
        registered.map_err(|error| format!("cannot handle signals: {error}"))?;
    }
    bridge::run(&name, &settings, &stop)
}
