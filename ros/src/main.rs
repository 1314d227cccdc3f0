//! `vlaps-ros`: a running set as ROS 2 topics.

use std::process::ExitCode;

use shm_config::text::{Printable, printable_lines};
use vlaps_ros::command::{HELP, publish};

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
