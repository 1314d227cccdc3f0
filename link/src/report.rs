//! What the link has done, for `./vlaps link status` and the run's folder.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use serde::Serialize;
use serde_json::{Value, json};
use shm_config::Instant;
use shm_config::file::{Durable, replace};

use crate::clock_map::ClockMap;
use crate::flow::{Inbox, Outbox, Received, Sent};
use crate::host::Host;
use crate::live::Live;
use crate::peer::Peer;
use crate::refusal::Refused;

/// Time between two reports, ns.
pub const REPORT_NS: u64 = 1_000_000_000;

/// What one row has sent and received.
#[derive(Debug, Clone, Copy, Default, Serialize)]
struct RowReport {
    #[serde(skip_serializing_if = "Option::is_none")]
    sent: Option<Sent>,
    #[serde(skip_serializing_if = "Option::is_none")]
    received: Option<Received>,
}

fn rows(outbox: &Outbox, inbox: &Inbox) -> BTreeMap<&'static str, RowReport> {
    let mut rows: BTreeMap<_, RowReport> = BTreeMap::new();
    for (row, sent) in outbox.sent() {
        rows.entry(row.service().unwrap_or("?")).or_default().sent = Some(sent);
    }
    for (row, received) in inbox.received() {
        rows.entry(row.service().unwrap_or("?"))
            .or_default()
            .received = Some(received);
    }
    rows
}

fn clock(clock: &ClockMap, now: Instant) -> Value {
    let Some(mapped) = clock.mapped(now.0) else {
        return Value::Null;
    };
    json!({
        "ahead_ms": mapped.offset_ns as f64 * 1e-6,
        "uncertainty_ms": mapped.uncertainty_ns as f64 * 1e-6,
        "round_trip_ms": mapped.round_trip_ns as f64 * 1e-6,
        "drift_ppm": clock.drift_ppm(),
        "jumps": clock.jumps,
    })
}

fn session(live: Option<&Live>, joins: u64, now: Instant) -> Value {
    json!({
        "is_joined": live.is_some(),
        "sessions": joins,
        "silent_ms": live.map(|live| now.since_ns(live.heard) as f64 * 1e-6),
        "clock": live.map(|live| clock(&live.clock, now)),
    })
}

/// The vehicle's report. `superseded` messages have come and were replaced by newer ones
/// before they were published.
pub fn of_host(host: &Host, address: &str, superseded: u64, now: Instant) -> Value {
    let peers: Vec<_> = host
        .guests()
        .map(|guest| {
            json!({
                "peer": guest.claim.peer,
                "role": guest.claim.role.word(),
                "expires_epoch_s": guest.claim.expires_epoch_s,
                "session": session(guest.live.as_ref(), guest.joins, now),
                "rows": rows(&guest.outbox, &guest.inbox),
            })
        })
        .collect();
    json!({
        "address": address,
        "peers": peers,
        "superseded": superseded,
        "refused": host.refused,
        "refused_total": host.refused.all(),
    })
}

/// The report of the side that joined: `run` is the vehicle's name of its run, and `dropped`
/// messages have come and were given to no program.
pub fn of_peer(peer: &Peer, (run, address): (&str, &str), dropped: u64, now: Instant) -> Value {
    let refused: &Refused = &peer.refused;
    json!({
        "run": run,
        "address": address,
        "role": peer.claim().role.word(),
        "session": session(peer.live.as_ref(), peer.joins, now),
        "rows": rows(&peer.outbox, &peer.inbox),
        "dropped": dropped,
        "refused": refused,
        "refused_total": refused.all(),
    })
}

/// Writes a report, whole or not at all.
///
/// # Errors
/// When the folder refuses.
pub fn write(path: &Path, report: &Value) -> io::Result<()> {
    let mut text = serde_json::to_string_pretty(report).map_err(io::Error::other)?;
    text.push('\n');
    replace(path, text.as_bytes(), Durable::No)
}
