//! Tests that every row of the service table is opened by the processes that it names.

use shm_config::services::{Process, SERVICES};
use shm_config::wire::Use;

/// A process, and the rows that one of its port structs uses.
type Opened = (Process, &'static [(&'static str, Use)]);

macro_rules! opened {
    ($($ports:path),+ $(,)?) => { &[$( (<$ports>::PROCESS, <$ports>::ROWS) ),+] };
}

const OPENED: &[Opened] = opened![
    robot::ports::Ports,
    sim::ports::RequestPorts,
    sim::ports::AnswerPorts,
    planner::ports::Ports,
    controller::ports::Ports,
    controller::ports::LoaderPorts,
    controller::ports::LearnerPorts,
    controller::ports::RecorderPorts,
    gate::ports::Ports,
    gate::ports::PicturePorts,
    learner::ports::Ports,
    learner::ports::OfferPorts,
    recorder::process::Ports,
    supervisor::telemetry::ports::Ports,
    supervisor::takeover::input::TakeoverPorts,
    supervisor::run::roster::RosterPorts,
];

/// Rows whose other end every process that the supervisor starts opens as it joins the
/// run: `runtime::Telemetry` publishes the first two, the wire reads the roster, and
/// `run.faults` the orders.
const BY_STARTED: [&str; 4] = ["health/*", "timing/*", "roster", "fault"];

fn is_opened(process: Process, row: &str, with: Use) -> bool {
    OPENED
        .iter()
        .filter(|(of, _)| *of == process)
        .any(|(_, rows)| rows.contains(&(row, with)))
}

#[test]
fn every_flow_of_the_table_has_its_ports() {
    let mut missing = Vec::new();
    for row in SERVICES {
        let writers = row.producers.iter().map(|process| (process, Use::Writes));
        let readers = row.consumers.iter().map(|process| (process, Use::Reads));
        for (process, with) in writers.chain(readers) {
            let as_it_joins = *process != Process::Supervisor && BY_STARTED.contains(&row.name);
            if !as_it_joins && !is_opened(*process, row.name, with) {
                missing.push(format!("{process} {with:?} {}", row.name));
            }
        }
    }
    assert!(missing.is_empty(), "no ports for: {missing:?}");
}

/// The macro refuses other rows at compile time; this test covers the whole list.
#[test]
fn no_process_opens_a_row_that_does_not_name_it() {
    for (process, rows) in OPENED {
        for (name, with) in *rows {
            let row = SERVICES.iter().find(|row| row.name == *name).expect(name);
            let is_named = match with {
                Use::Reads => row.is_consumed_by(*process),
                Use::Writes => row.is_produced_by(*process),
            };
            assert!(is_named, "{process} {with:?} {name}");
        }
    }
}
