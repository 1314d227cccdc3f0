//! The vehicle's end of the network: door, listener, configuration, report.

use std::path::PathBuf;
use std::time::UNIX_EPOCH;

use shm_config::Instant;
use shm_config::config::{Config, Link, Programs};
use shm_config::run::{RunName, RunPaths};

use crate::carrier::Listener;
use crate::host::{Event, Host, Seats};
use crate::keys::RunKeys;
use crate::refusal::Reason;
use crate::report;
use crate::role::CONFIG;

/// Packets that are read in one turn, so that a flood does not keep the loop from its own
/// work.
const TURN_MAX: usize = 256;
/// Time between two looks at the list of revoked invitations, ns.
const KEYS_NS: u64 = 2_000_000_000;

/// The vehicle's end.
pub struct Station {
    /// The door.
    pub host: Host,
    /// Messages that passed the door and were not published, because a newer one had come.
    pub superseded: u64,
    listener: Listener,
    address: String,
    name: RunName,
    report: PathBuf,
    reported: Instant,
    keys_read: Instant,
    told_refused: u64,
}

/// The configuration as peers get it: without what belongs to this machine, and without the
/// address of a model, which may hold a key.
///
/// # Errors
/// When it cannot be written as TOML.
pub fn config_text(config: &Config) -> Result<String, String> {
    let mut config = config.clone();
    config.programs = Programs::default();
    config.link = Link::default();
    let own = Config::default().vlm;
    config.vlm.server = own.server;
    config.vlm.key_env = own.key_env;
    config.vlm.key_file = own.key_file;
    config.vlm.ca_file = own.ca_file;
    config.vlm.key_over_http = own.key_over_http;
    config.policy.file = String::new();
    config.record.folder = String::new();
    toml::to_string(&config).map_err(|error| format!("the configuration: {error}"))
}

/// The line above the configuration that tells one run from the next of the same name and
/// settings: what joined then begins anew. A process that is started again within its run
/// makes the same line.
fn run_line(name: &RunName) -> String {
    let paths = RunPaths::new(name.clone());
    let supervisor = paths.supervisor_pid().unwrap_or_default();
    // The supervisor writes it once, at its start; process ids come again.
    let written = paths
        .config_file()
        .metadata()
        .and_then(|data| data.modified());
    let since = written.map(|at| at.duration_since(UNIX_EPOCH).unwrap_or_default());
    let written_ns = since.unwrap_or_default().as_nanos();
    format!("# run of supervisor {supervisor}, begun at {written_ns}\n")
}

impl Station {
    /// Listens for the peers of a run.
    ///
    /// # Errors
    /// One line: the run has invited no peer, or the address cannot be used.
    pub fn open(
        config: &Config,
        seats: Seats,
        address: &str,
        now: Instant,
    ) -> Result<Self, String> {
        let name: RunName = config
            .run
            .name
            .parse()
            .map_err(|error| format!("{error}"))?;
        let keys = RunKeys::read(&name).map_err(|error| error.to_string())?;
        let keys = keys.ok_or_else(|| {
            format!(
                "run '{name}' has no keys, so no peer could join; make them with `./vlaps link \
                 invite --run {name} --as ROLE --address HOST:PORT --out FILE`"
            )
        })?;
        let listener = Listener::open(&keys, address)?;
        let mut host = Host::new(keys, seats).map_err(|error| error.to_string())?;
        let text = format!("{}{}", run_line(&name), config_text(config)?);
        host.push(CONFIG, text.into_bytes().into());
        let report = match seats {
            Seats::One(role) => format!("link-{role}.json"),
            Seats::Readers => "link-readers.json".into(),
        };
        Ok(Self {
            host,
            superseded: 0,
            listener,
            address: address.into(),
            name,
            report: PathBuf::from(&config.run.folder).join(report),
            reported: Instant(0),
            keys_read: now,
            told_refused: 0,
        })
    }

    /// Reads what has come, and gives what happened.
    pub fn receive(&mut self, (now, epoch_s): (Instant, u64)) -> Vec<Event> {
        for _ in 0..TURN_MAX {
            let Some(arrived) = self.listener.receive() else {
                break;
            };
            self.host
                .receive(&arrived.bytes, (arrived.at, now), epoch_s);
        }
        let flooded = self.listener.take_flooded();
        self.host.refused.add(Reason::Flooded, flooded);
        let events = self.host.take_events();
        events.iter().for_each(tell);
        events
    }

    /// Sends what is due, and reports.
    pub fn send(&mut self, (now, epoch_s): (Instant, u64)) {
        self.host.poll(now, epoch_s);
        self.flush();
        if now.since_ns(self.reported) >= report::REPORT_NS {
            self.reported = now;
            self.write_report(now);
        }
        if now.since_ns(self.keys_read) >= KEYS_NS {
            self.keys_read = now;
            self.host.renew(RunKeys::read(&self.name));
        }
    }

    fn flush(&mut self) {
        for (role, peer, bytes) in self.host.take_out() {
            self.listener.send((role, peer), bytes);
        }
    }

    fn write_report(&mut self, now: Instant) {
        let refused = self.host.refused.all();
        if refused > self.told_refused {
            self.told_refused = refused;
            let by_reason = serde_json::to_string(&self.host.refused).unwrap_or_default();
            tracing::warn!(refused, by_reason, "refused from the network");
        }
        let text = report::of_host(&self.host, &self.address, self.superseded, now);
        // A full disk costs the report, and nothing else.
        let _ = report::write(&self.report, &text);
    }

    /// Tells the peers that this end closes.
    pub fn close(&mut self, now: Instant) {
        self.host.end();
        self.flush();
        self.write_report(now);
    }
}

fn tell(event: &Event) {
    match event {
        Event::Joined(claim) => {
            tracing::info!(role = claim.role.word(), peer = %claim.peer, "joined");
        }
        Event::Left(claim, why) => {
            tracing::warn!(role = claim.role.word(), peer = %claim.peer, why, "left");
        }
        Event::Jumped(claim, by_ns) => {
            let by_ms = *by_ns as f64 * 1e-6;
            tracing::warn!(role = claim.role.word(), peer = %claim.peer, by_ms, "its clock has jumped");
        }
        Event::Closed(Some(why)) => {
            tracing::error!("{why}: all of its invitations are revoked until they are back");
        }
        Event::Closed(None) => tracing::warn!("the run's keys are back"),
        Event::Message(..) => {}
    }
}
