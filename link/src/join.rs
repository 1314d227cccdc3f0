//! The side that joins: the vehicle's rows in a run of this machine, an unchanged program on
//! them, and what it publishes back.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use shm_config::Instant;
use shm_config::config::Config;
use shm_config::run::{RunName, RunPaths};

use crate::carrier::Connection;
use crate::clock_map::ClockMap;
use crate::held::Held;
use crate::keys::Bundle;
use crate::local::{Local, make_folder};
use crate::mirror::{REMOVED_NS, Shift, is_removed, remove};
use crate::peer::{News, Peer, Vehicle};
use crate::refusal::Reason;
use crate::report;
use crate::role::{CONFIG, Role, RowId};
use crate::stand_in::clocks;

/// Longest wait for a packet before the program's answers are read.
const TURN: Duration = Duration::from_millis(1);
/// Packets that are read in one turn.
const TURN_MAX: usize = 256;
/// Time between two looks at program and connections, ns.
const LOOK_NS: u64 = 20_000_000;
/// The vehicle has this long to answer until the connection is made anew, ns.
const ANSWER_NS: u64 = 1_500_000_000;
/// The vehicle's clock is mapped after this many round trips: the first ones include the start
/// of the connection.
const SAMPLES: usize = 3;
/// The vehicle's clock may be this far off from the map in use until it is drawn anew, ns: a
/// tenth of the shortest time that advice is held.
const OFF_NS_MAX: u64 = 100_000_000;

/// How to join.
pub struct Options {
    /// The invitation.
    pub bundle: Bundle,
    /// `HOST:PORT` of the vehicle, when it is not the invitation's.
    pub address: String,
    /// The run's name on this machine.
    pub name: RunName,
    /// This machine's own settings: the model that a judge asks, and files of this machine.
    pub own: Config,
}

/// How long the vehicle has not answered.
#[derive(Debug)]
struct Silence {
    since: Instant,
    was_open: bool,
}

impl Silence {
    /// The vehicle has answered.
    fn end(&mut self, at: Instant) {
        self.since = self.since.max(at);
    }

    /// Whether it is too long; then it begins anew. A connection can be answered from the
    /// look on at which it is open.
    fn is_long(&mut self, now: Instant, is_open: bool) -> bool {
        if is_open && !self.was_open {
            self.since = now;
        }
        self.was_open = is_open;
        let is_long = now.since_ns(self.since) > ANSWER_NS;
        if is_long {
            self.since = now;
        }
        is_long
    }
}

/// The join in progress.
struct Join<'a> {
    options: &'a Options,
    role: Role,
    peer: Peer,
    connection: Connection,
    local: Option<Local>,
    /// The configuration of the run that comes next, while the last one ends.
    next: Option<String>,
    /// What the last run leaves on this machine, and since when.
    leaving: Option<(RunPaths, Instant)>,
    held: Held,
    /// The last message of each row that was sent to the vehicle.
    last: BTreeMap<RowId, Arc<[u8]>>,
    /// The vehicle's process is another one than the last messages went to.
    is_new: bool,
    shift: Option<Shift>,
    silence: Silence,
    looked: Instant,
    reported: Instant,
    last_refusal: Option<Reason>,
    /// That no vehicle answers is told once.
    is_told: bool,
    report: PathBuf,
}

/// Joins until `stop` is set.
///
/// # Errors
/// One line: the invitation is damaged, the run lives already, or the program ends each time.
pub fn join(options: &Options, stop: &AtomicBool) -> Result<(), String> {
    let mut join = Join::new(options, make_folder(options)?)?;
    let role = join.role.word();
    tracing::info!(address = options.address, role, "joins");
    let ended = join.work(stop);
    join.peer.end();
    join.flush();
    join.close();
    ended
}

impl<'a> Join<'a> {
    fn new(options: &'a Options, folder: PathBuf) -> Result<Self, String> {
        let (now, _) = clocks();
        Ok(Self {
            options,
            role: options.bundle.role().map_err(|error| error.to_string())?,
            peer: Peer::new(&options.bundle).map_err(|error| error.to_string())?,
            connection: Connection::open(&options.bundle, &options.address)?,
            local: None,
            next: None,
            leaving: None,
            held: Held::default(),
            last: BTreeMap::new(),
            is_new: false,
            shift: None,
            silence: Silence {
                since: now,
                was_open: false,
            },
            looked: Instant(0),
            reported: Instant(0),
            last_refusal: None,
            is_told: false,
            report: folder.join("link-join.json"),
        })
    }

    fn work(&mut self, stop: &AtomicBool) -> Result<(), String> {
        while !stop.load(Ordering::Relaxed) {
            self.receive();
            let (now, _) = clocks();
            for news in self.peer.take_news() {
                self.hear(news, now)?;
            }
            self.map(now);
            self.release();
            self.answer();
            self.peer.poll(now);
            self.flush();
            self.look(now)?;
        }
        Ok(())
    }

    fn receive(&mut self) {
        let mut wait = TURN;
        for _ in 0..TURN_MAX {
            let Some(arrived) = self.connection.receive(wait) else {
                break;
            };
            let (now, _) = clocks();
            self.peer.receive(&arrived.bytes, (arrived.at, now));
            wait = Duration::ZERO;
        }
        let flooded = self.connection.take_flooded();
        self.peer.refused.add(Reason::Flooded, flooded);
        if let Some(live) = &self.peer.live {
            self.silence.end(live.heard);
        }
    }

    fn flush(&mut self) {
        for bytes in self.peer.take_out() {
            self.connection.send(bytes);
        }
    }

    fn hear(&mut self, news: News, now: Instant) -> Result<(), String> {
        match news {
            News::Joined(vehicle) => {
                self.silence.end(now);
                (self.last_refusal, self.is_told) = (None, false);
                if vehicle == Vehicle::New {
                    self.shift = None;
                    self.is_new = true;
                }
                tracing::info!(vehicle = ?vehicle, "joined");
            }
            News::Lost(why) => {
                // The connection may be well and the vehicle busy; it is made anew when no
                // hello is answered.
                tracing::warn!(why, "the session is over; greets again");
                self.silence.end(now);
            }
            News::Refused(reason) => {
                self.silence.end(now);
                if self.last_refusal.replace(reason) != Some(reason) {
                    tracing::error!(reason = reason.word(), "{}", advice_on(reason));
                }
            }
            News::Jumped(by_ns) => {
                let by_ms = by_ns as f64 * 1e-6;
                tracing::warn!(by_ms, "the vehicle's clock, or this one, has jumped");
                self.shift = None;
            }
            News::Message(CONFIG, bytes) => {
                let text = String::from_utf8(bytes.to_vec());
                let text = text.map_err(|_| "the vehicle's configuration is no text")?;
                self.configure(text);
            }
            News::Message(row, bytes) => self.held.push(self.role, row, bytes),
        }
        Ok(())
    }

    /// Gives the program what has come, as soon as it takes it.
    fn release(&mut self) {
        let local = self.local.as_mut().filter(|_| self.next.is_none());
        let Some(local) = local else {
            return;
        };
        let Some(shift) = local.takes(self.shift) else {
            return;
        };
        while let Some((row, bytes)) = self.held.pop() {
            if let Err(reason) = local.write(row, &bytes, shift) {
                self.peer.refused.count(reason);
            }
        }
    }

    /// Draws the map of the vehicle's clock, once: a question and its answer then differ by
    /// nothing. What the map is off by is added to all ages.
    fn map(&mut self, now: Instant) {
        let clock = self.peer.live.as_ref().map(|live| &live.clock);
        let samples = clock.map_or(0, ClockMap::samples);
        let Some(mapped) = clock.and_then(|clock| clock.mapped(now.0)) else {
            return;
        };
        let late_ns = i64::try_from(mapped.uncertainty_ns).unwrap_or(i64::MAX);
        let shift = Shift((-mapped.offset_ns).saturating_sub(late_ns));
        match self.shift {
            None if samples < SAMPLES => {}
            None => {
                let ahead_ms = mapped.offset_ns as f64 * 1e-6;
                let uncertainty_ms = mapped.uncertainty_ns as f64 * 1e-6;
                tracing::info!(ahead_ms, uncertainty_ms, "the vehicle's clock is mapped");
                self.shift = Some(shift);
            }
            Some(used) if used.0.abs_diff(shift.0) > OFF_NS_MAX + mapped.uncertainty_ns => {
                let by_ms = (shift.0 - used.0) as f64 * 1e-6;
                tracing::warn!(by_ms, "the clocks have run apart; mapped anew");
                self.shift = Some(shift);
            }
            Some(_) => {}
        }
    }

    /// The vehicle's configuration has come. It names its run: a program does not go on from
    /// one run to the next, even when both have the same settings.
    fn configure(&mut self, text: String) {
        let is_new = std::mem::take(&mut self.is_new);
        if self.next.as_ref() == Some(&text) {
            // What waits has come since it was said first, and is of the run that begins.
            return;
        }
        let runs = self.local.as_ref().is_some_and(|local| local.is_of(&text));
        if runs && self.next.is_none() {
            if is_new {
                // The vehicle's process was started again within its run, and has nothing.
                for (row, bytes) in &self.last {
                    self.peer.push(*row, bytes.clone());
                }
            }
            return;
        }
        if self.local.is_some() {
            tracing::warn!("the vehicle has another run or configuration; begins anew");
        }
        // Before the first run, what waits is of this run.
        if self.local.is_some() || self.next.is_some() || self.leaving.is_some() {
            self.held.clear();
        }
        self.last.clear();
        self.peer.outbox.clear();
        self.next = Some(text);
    }

    /// Ends the last run and begins the next one, a step in each look, so that the vehicle
    /// is answered meanwhile.
    fn change(&mut self, now: Instant) -> Result<(), String> {
        if self.next.is_none() {
            return Ok(());
        }
        if let Some(local) = &mut self.local {
            if !local.has_ended(now) {
                return Ok(());
            }
            let paths = self.local.take().map(Local::close);
            self.leaving = paths.map(|paths| (paths, now));
        }
        if let Some((paths, since)) = &self.leaving {
            if !is_removed(paths) && now.since_ns(*since) < REMOVED_NS {
                return Ok(());
            }
            self.leaving = None;
        }
        if let Some(text) = self.next.take() {
            self.local = Some(Local::open(self.options, self.role, text)?);
        }
        Ok(())
    }

    /// Sends what the program has published.
    fn answer(&mut self) {
        let local = self.local.as_mut().filter(|_| self.next.is_none());
        if let Some(local) = local {
            local.answer(self.shift, &mut |row, bytes| {
                self.last.insert(row, bytes.clone());
                self.peer.push(row, bytes);
            });
        }
    }

    /// Looks at what changes seldom.
    fn look(&mut self, now: Instant) -> Result<(), String> {
        if now.since_ns(self.looked) < LOOK_NS {
            return Ok(());
        }
        self.looked = now;
        let is_open = self.connection.is_open();
        if self.silence.is_long(now, is_open) && self.peer.live.is_none() {
            if is_open {
                self.connection.renew();
            }
            if !self.is_told {
                self.is_told = true;
                let address = &self.options.address;
                tracing::warn!(address, "no vehicle answers; tries on");
            }
        }
        if now.since_ns(self.reported) >= report::REPORT_NS {
            self.reported = now;
            let vehicle = (&*self.options.bundle.run, &*self.options.address);
            let text = report::of_peer(&self.peer, vehicle, self.held.dropped, now);
            // A full disk costs the report, and nothing else.
            let _ = report::write(&self.report, &text);
        }
        self.change(now)?;
        match &mut self.local {
            Some(local) if self.next.is_none() => local.look(now),
            _ => Ok(()),
        }
    }

    fn close(&mut self) {
        let left = self.local.take().map(Local::close);
        let left = left.or_else(|| self.leaving.take().map(|(paths, _)| paths));
        if let Some(paths) = left {
            remove(&paths);
        }
    }
}

/// What a user does about a refusal.
fn advice_on(reason: Reason) -> &'static str {
    match reason {
        Reason::OtherRun => "the invitation is of another run; ask for one of this run",
        Reason::WrongKey => "the invitation is not of this run's keys; ask for a new one",
        Reason::WrongRole => "this port is of another role; use the port of yours",
        Reason::Expired => "the invitation has ended; ask for a new one",
        Reason::Revoked => "the invitation was revoked; ask for a new one",
        Reason::OtherLayout => "the vehicle has another version; build both from one source",
        Reason::Occupied => {
            "another peer has this role now, or another process this invitation; tries again"
        }
        _ => "the vehicle refuses",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::keys::RunKeys;
    use shm_config::services::STEP;

    #[test]
    fn a_connection_has_its_whole_time_to_answer_from_when_it_is_open() {
        let second = |tenths: u64| Instant(tenths * 100_000_000);
        let mut silence = Silence {
            since: second(0),
            was_open: false,
        };
        let mut is_long = |tenths, is_open| silence.is_long(second(tenths), is_open);
        // It takes 2.9 s to connect, which is told after 1.6 s.
        assert!(!is_long(15, false));
        assert!(is_long(16, false));
        assert!(!is_long(29, true));
        assert!(!is_long(44, true));
        assert!(is_long(45, true));
        // Connected anew within a look: it has its time, too.
        assert!(!is_long(60, true));
        silence.end(second(60));
        assert!(!silence.is_long(second(75), true));
        assert!(silence.is_long(second(76), true));
    }

    #[test]
    fn messages_that_wait_are_dropped_for_another_run_alone() {
        let bundle = RunKeys::make("drive").expect("keys");
        // Nothing listens there.
        let address = "127.0.0.1:9".to_string();
        let bundle = bundle.invite(Role::View, &address, 4_000_000_000);
        let options = Options {
            bundle: bundle.expect("an invitation"),
            address,
            name: "drive-view".parse().expect("a name"),
            own: Config::default(),
        };
        let mut join = Join::new(&options, PathBuf::new()).expect("a join");
        let step = RowId::of(STEP.name).expect("a row");
        let mut step_and = |text: Option<&str>| {
            let bytes: Arc<[u8]> = [7][..].into();
            let message = News::Message(step, bytes);
            join.hear(message, Instant(0)).expect("it is held");
            if let Some(text) = text {
                join.configure(text.into());
            }
            join.held.dropped
        };
        // A step that comes before the first configuration waits for its run.
        assert_eq!(step_and(Some("one run")), 0);
        assert_eq!(step_and(Some("one run")), 0);
        assert_eq!(step_and(Some("another run")), 3);
        assert_eq!(step_and(None), 3);
        assert_eq!(join.held.pop(), Some((step, [7][..].into())));
        assert_eq!(join.held.pop(), None);
    }
}
