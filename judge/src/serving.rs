//! `vlaps-judge serve`.

use anyhow::Context as _;
use judge::standin::{NAME, Server};
use shm_config::counted;

use crate::arguments::ServeArguments;
use crate::print::say;

/// Runs a stand-in until a signal arrives.
pub fn serve(arguments: &ServeArguments) -> anyhow::Result<()> {
    let stop = [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM];
    let mut stop = signal_hook::iterator::Signals::new(stop).context("cannot handle signals")?;
    let server = Server::start(arguments.options()).with_context(|| {
        let port = arguments.port;
        format!("cannot listen on 127.0.0.1:{port}; --port 0 takes any free one")
    })?;
    let url = server.url();
    say(format_args!(
        "{NAME} listens on {url}: a stand-in that judges by the colours of pixels, not a model; with \
         vlm.model={NAME} it is free. Ctrl-C stops it"
    ));
    if let Some(injected) = arguments.fault {
        let share = arguments.fault_share;
        let injected = injected.word();
        say(format_args!(
            "injects a fault into a share of {share} of its questions: {injected}"
        ));
    }
    stop.forever().next();
    let answered = counted(server.requests(), "question");
    say(format_args!("answered {answered}"));
    Ok(())
}
