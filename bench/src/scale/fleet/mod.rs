//! `bench scale --fleet`: actors with one learner and cars with one server, from measured
//! costs.
//!
//! | module | holds |
//! |---|---|
//! | [`costs`] | unit costs, and the flows of a car by the service table |
//! | [`model`] | parts with their loads, and in which order they break |
//! | [`queue`] | a queue with several servers, simulated event by event |

pub mod costs;
pub mod model;
pub mod queue;

use std::process::ExitCode;

use lab::report::table;
use serde::Serialize;
use supervisor::subcommand::{say, write_json_option};

use super::{BenchScale, figure};
use costs::{
    ANSWER_S, ANSWERS_AT_ONCE, BLOCK, Flow, QUESTIONS_HZ, SERVER_CORES, flows, receiving_s,
};
use model::{Break, Part, block_s, of_actors, of_cars, repair, transitions_per_s};
use queue::{Queue, Queued, Sending};

/// Messages that wait at most: the depth of the queue of steps.
const STEP_QUEUE: usize = 2048;
/// Simulated time at most, s.
const SECONDS: f64 = 30.0;
/// Services that fit into the simulated time of a large fleet at least.
const SERVICES_MIN: f64 = 10.0;
/// Seed of the simulation.
const SEED: u64 = 1;
/// Shares of the members with which a queue is just full.
const NEAR_FULL: [f64; 3] = [0.5, 0.9, 1.1];
/// Simulated members at most: a larger fleet is simulated by so many, each of which sends as
/// often as several, for a shorter time.
const SIMULATED_MAX: u64 = 10_000;

/// A fleet.
#[derive(Clone, Debug, Serialize)]
pub struct Fleet {
    /// What its members are.
    pub members_are: &'static str,
    /// Number of members.
    pub members: u64,
    /// Its parts.
    pub parts: Vec<Load>,
    /// The parts that break, in order, each after the ones before are repaired.
    pub breaks: Vec<Break>,
    /// Simulated queues.
    pub queues: Vec<Simulated>,
}

/// A part with its load.
#[derive(Clone, Debug, Serialize)]
pub struct Load {
    /// The part.
    #[serde(flatten)]
    pub part: Part,
    /// Its load with the whole fleet.
    pub load: f64,
}

/// A simulated queue.
#[derive(Clone, Debug, Serialize)]
pub struct Simulated {
    /// The part.
    pub part: &'static str,
    /// Members that send.
    pub members: u64,
    /// Simulated time, s.
    pub seconds: f64,
    /// What became of the messages.
    #[serde(flatten)]
    pub queued: Queued,
}

/// Both fleets.
#[derive(Clone, Debug, Serialize)]
struct FleetResults {
    flows: Vec<Flow>,
    fleets: Vec<Fleet>,
}

/// Prints the fleets.
///
/// # Errors
/// If a flow has no known rate, or a file cannot be written.
pub fn run(arguments: &BenchScale) -> anyhow::Result<ExitCode> {
    let flows =
        flows().map_err(|name| anyhow::anyhow!("{name}: its rate in a fleet is unknown"))?;
    let actors = Queue {
        members: 0,
        messages_per_s: transitions_per_s() / BLOCK,
        service_s: block_s(),
        servers: SERVER_CORES as u64,
        // Back-pressure: an actor waits, and nothing is lost.
        waiting_max: usize::MAX,
        sending: Sending::Periodic,
    };
    let judge = Queue {
        members: 0,
        messages_per_s: QUESTIONS_HZ,
        service_s: ANSWER_S,
        servers: ANSWERS_AT_ONCE as u64,
        // A question that waits for longer than a period is replaced by the next one.
        waiting_max: (ANSWERS_AT_ONCE / ANSWER_S / QUESTIONS_HZ) as usize,
        sending: Sending::Periodic,
    };
    let messages_per_s = flows.iter().map(|flow| flow.messages_per_s).sum();
    let messages = Queue {
        members: 0,
        messages_per_s,
        service_s: receiving_s(&flows) / messages_per_s,
        servers: SERVER_CORES as u64,
        waiting_max: STEP_QUEUE,
        sending: Sending::Periodic,
    };
    let fleets = vec![
        fleet(
            "actors",
            arguments.actors,
            of_actors(),
            &[("receiving of blocks", actors)],
        ),
        fleet(
            "cars",
            arguments.cars,
            of_cars(&flows),
            &[("judge", judge), ("receiving of messages", messages)],
        ),
    ];
    print_flows(&flows);
    fleets.iter().for_each(print);
    write_json_option(&arguments.json, &FleetResults { flows, fleets })?;
    Ok(ExitCode::SUCCESS)
}

fn fleet(
    members_are: &'static str,
    members: u64,
    parts: Vec<Part>,
    queues: &[(&'static str, Queue)],
) -> Fleet {
    let breaks = repair(&parts, members);
    let queues = queues.iter().flat_map(|&(part, queue)| {
        let full = queue.servers as f64 / (queue.messages_per_s * queue.service_s);
        let near = NEAR_FULL.map(|share| (share * full).round().max(1.0) as u64);
        let all = near.into_iter().chain([members]);
        all.map(move |members| simulated(part, Queue { members, ..queue }))
    });
    Fleet {
        members_are,
        members,
        queues: queues.collect(),
        breaks,
        parts: parts
            .into_iter()
            .map(|part| Load {
                load: part.load(members),
                part,
            })
            .collect(),
    }
}

fn simulated(part: &'static str, queue: Queue) -> Simulated {
    let members = queue.members;
    // The servers get as many messages a second as from the whole fleet.
    let share = (SIMULATED_MAX as f64 / members as f64).min(1.0);
    // As many messages altogether, however large the fleet is.
    let seconds = (SECONDS * share).max(SERVICES_MIN * queue.service_s);
    let queue = Queue {
        members: members.min(SIMULATED_MAX),
        messages_per_s: queue.messages_per_s / share,
        ..queue
    };
    Simulated {
        part,
        members,
        seconds,
        queued: queue.simulate(seconds, SEED),
    }
}

fn print_flows(flows: &[Flow]) {
    let mut rows = table(&[
        "one car to the server",
        "messages/s",
        "bytes",
        "kB/s",
        "queue, kB",
    ]);
    for flow in flows {
        rows.add_row([
            flow.service.to_string(),
            figure(flow.messages_per_s),
            figure(flow.message_bytes),
            figure(flow.bytes_per_s() * 1e-3),
            figure(flow.queue_bytes * 1e-3),
        ]);
    }
    say(rows);
}

fn print(fleet: &Fleet) {
    let Fleet {
        members_are,
        members,
        ..
    } = fleet;
    let load = format!("load of {members}");
    let full = format!("full with {members_are}");
    let mut rows = table(&["part", "one asks for", &load, &full]);
    for Load { part, load } in &fleet.parts {
        let full = part.members_max();
        rows.add_row([
            part.name.to_string(),
            part.demand.clone(),
            figure(*load),
            full.map_or("any number".into(), figure),
        ]);
    }
    say(rows);
    for (index, of) in fleet.breaks.iter().enumerate() {
        let count = match of.count_after {
            1 => String::new(),
            count => format!(" ({count} of them)"),
        };
        let full = of.members_max.map_or("any number of".into(), figure);
        say(format_args!(
            "{}. {} breaks, full with {full} {members_are}, load {}: {}{count}; load then {}",
            index + 1,
            of.part,
            figure(of.load),
            of.remedy,
            figure(of.load_after)
        ));
    }
    if fleet.breaks.is_empty() {
        say(format_args!("{members} {members_are}: no part breaks"));
    }
    let mut rows = table(&[
        "simulated queue",
        members_are,
        "simulated, s",
        "used",
        "wait mean, ms",
        "wait p99, ms",
        "sent",
        "lost",
        "left",
    ]);
    for Simulated {
        part,
        members,
        seconds,
        queued,
    } in &fleet.queues
    {
        rows.add_row([
            part.to_string(),
            members.to_string(),
            figure(*seconds),
            figure(queued.utilisation),
            figure(queued.wait_mean_s * 1e3),
            figure(queued.wait_p99_s * 1e3),
            queued.sent.to_string(),
            queued.lost.to_string(),
            queued.left.to_string(),
        ]);
    }
    say(rows);
    say(format_args!("seed {SEED}"));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fleet_of_any_size_is_simulated_with_a_bounded_number_of_messages() {
        let queue = Queue {
            members: 0,
            messages_per_s: 1.0,
            service_s: 80e-6,
            servers: 16,
            waiting_max: STEP_QUEUE,
            sending: Sending::Periodic,
        };
        let [small, large] = [SIMULATED_MAX, 1_000_000]
            .map(|members| simulated("messages", Queue { members, ..queue }));
        assert_eq!(small.seconds, SECONDS);
        assert!((large.seconds - SECONDS / 100.0).abs() < 1e-9);
        let (sent, all) = (large.queued.sent as f64, small.queued.sent as f64);
        assert!((sent / all - 1.0).abs() < 0.01, "{sent}, {all}");
    }
}
