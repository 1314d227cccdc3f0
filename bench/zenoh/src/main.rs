//! Round trips over Zenoh, as `vlaps bench ipc` makes them over shared memory.
//!
//! `vlaps-zenoh BYTES spin|bell PERIOD_NS WARM COUNT CORE_PING CORE_ECHO`
//!
//! Starts the answering process and prints half of each counted round trip, ns, one per
//! line. A negative core means no pinning. Both ends read from a ring of one message,
//! without batching, and drop when congested: the stack's `latest value wins`.

mod round_trip;
mod words;

use std::process::ExitCode;

use words::Words;

fn main() -> ExitCode {
    let all: Vec<String> = std::env::args().skip(1).collect();
    let Some(words) = Words::read(&all) else {
        eprintln!("vlaps-zenoh BYTES spin|bell PERIOD_NS WARM COUNT CORE_PING CORE_ECHO");
        return ExitCode::from(2);
    };
    let done = match &words.endpoint {
        Some(endpoint) => round_trip::echo(&words, endpoint),
        None => round_trip::ping(&words, &all),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("vlaps-zenoh: {error}");
            ExitCode::FAILURE
        }
    }
}
