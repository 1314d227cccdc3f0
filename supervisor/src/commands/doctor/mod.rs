//! `doctor`: what this machine grants, and how to grant what is missing.
//!
//! Privileges are tried, not deduced: a limit that looks sufficient may still be
//! overruled by a container or a control group.

mod checks;
pub mod finding;
pub mod grants;
mod privileges;
mod runs;

use crate::Clock;
use crate::cli::failure::Failure;
use crate::cli::print::say;
use checks::{clock_source, cores, governor, isolated, kernel, memory, sleep, throttling};
use finding::Grade;
use privileges::{locked_memory, priority};
use runs::tell_of_sets;

/// Makes all checks and prints their findings.
///
/// # Errors
/// When something is missing that a run cannot do without.
pub fn doctor(clock: Clock) -> Result<(), Failure> {
    let mut findings = [
        priority(),
        locked_memory(),
        memory(),
        cores(),
        isolated(),
        kernel(),
        throttling(),
        governor(),
        sleep(),
        clock_source(),
    ];
    // Commands that repair both findings are printed once.
    if findings[0].remedy == findings[1].remedy && findings[1].grade == Grade::Missing {
        findings[1].remedy = vec!["the same commands grant it".into()];
    }
    for finding in &findings {
        say(finding);
    }
    tell_of_sets(clock);
    let missing = |grade| {
        findings
            .iter()
            .filter(|finding| finding.grade == grade)
            .count()
    };
    let (fatal, poor) = (missing(Grade::Fatal), missing(Grade::Missing));
    if fatal > 0 {
        return Err(Failure::GivenUp(format!(
            "{fatal} of these must be repaired before a set can run"
        )));
    }
    say(match poor {
        0 => "a set runs here with everything it asks for".into(),
        _ => format!("a set runs here, less punctually than it could: {poor} missing"),
    });
    Ok(())
}
