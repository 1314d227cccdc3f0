//! What the tested world has published.

use shm_config::config::Config;
use shm_config::message::{Episode, Health, Message, Observation, Progress};
use shm_config::{Instant, RunGrid};
use vehicle::Scanner;

/// A health message dated farther than this from its arrival has a wrong instant, ns: a
/// delay of the reader, which is under a second, explains no more.
const DATED_NS: u64 = 10_000_000_000;

/// What is kept of an observation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub(super) tick: u64,
    pub(super) episode: u32,
    pub(super) scheduled_ns: u64,
    pub(super) released_ns: u64,
    pub(super) heading_rad: f64,
    pub(super) yaw_rate_radps: f64,
    pub(super) speed_mps: f64,
}

/// Messages of the world since it was last started.
pub(super) struct Watched {
    grid: RunGrid,
    period_ns: u64,
    scanner: Scanner,
    /// All valid observations of its ticks, one of each tick.
    pub(super) seen: Vec<Seen>,
    /// Observations in all.
    pub(super) observations: u64,
    /// Those with invalid content; why the first is.
    pub(super) invalid: Count,
    /// Those of another scanner than the run's; the first difference.
    pub(super) other_scanner: Count,
    /// Those off the grid, or at a wrong time.
    pub(super) off_grid: Count,
    /// Those whose tick is not that of their instant, or of an earlier episode.
    pub(super) misnumbered: Count,
    /// Observations that were overwritten before they were read here.
    pub(super) lost: u64,
    /// Progress messages, and those that are invalid.
    pub(super) progresses: u64,
    pub(super) invalid_progress: Count,
    /// The newest count of ticks braked for want of a command.
    pub(super) braked: u64,
    pub(super) episodes: Vec<Episode>,
    pub(super) health: Option<Health>,
    pub(super) healths: u64,
    /// Health messages in which ticks and skipped ones are not those due.
    pub(super) unaccounted: Count,
    /// When the newest health message was published, ns.
    heard_ns: Option<u64>,
    /// Longest time between two health messages, ns: by the world's own instants, so that
    /// a delay of this reader changes nothing.
    pub(super) silent_ns: u64,
    /// Health messages whose instant is far from that of their arrival.
    pub(super) misdated: Count,
    /// Timing messages, and the ticks that the newest counts.
    pub(super) timings: u64,
    pub(super) timed: u64,
}

/// How often something was found, and the first finding.
#[derive(Clone, Debug, Default)]
pub(super) struct Count {
    pub(super) count: u64,
    pub(super) first: Option<String>,
}

impl Count {
    fn note(&mut self, finding: impl FnOnce() -> String) {
        self.count += 1;
        self.first.get_or_insert_with(finding);
    }

    /// As a figure: how many of `of`, and the first.
    pub(super) fn of(&self, of: u64) -> String {
        match &self.first {
            None => format!("0 of {of}"),
            Some(first) => format!("{} of {of}; the first: {first}", self.count),
        }
    }
}

/// What an observation shows of its scanner that is not the run's.
fn difference(scanner: &Scanner, observation: &Observation) -> Option<String> {
    let fan = scanner.fan();
    let rows = [
        (
            "beam_count",
            f64::from(observation.beam_count),
            fan.beams as f64,
        ),
        (
            "lidar_max_m",
            observation.lidar_max_m.into(),
            scanner.range_m,
        ),
        (
            "field_of_view_rad",
            observation.field_of_view_rad,
            fan.field_of_view_rad,
        ),
        (
            "scanner_heading_rad",
            observation.scanner_heading_rad,
            fan.heading_rad,
        ),
        (
            "scanner_x_body_m",
            observation.scanner_x_body_m,
            fan.mount_body.x,
        ),
        (
            "scanner_y_body_m",
            observation.scanner_y_body_m,
            fan.mount_body.y,
        ),
    ];
    // The range has 32 bits.
    let found = rows
        .into_iter()
        .find(|(_, shown, is)| (shown - is).abs() > 1e-4);
    found.map(|(field, shown, is)| format!("{field} is {shown}, in [scanner] {is}"))
}

impl Watched {
    /// Of a world in a run of this configuration.
    pub(super) fn new(config: &Config) -> Self {
        Self {
            grid: RunGrid::of(config),
            period_ns: config.run.period_ns(),
            scanner: config.scanner,
            seen: Vec::new(),
            observations: 0,
            invalid: Count::default(),
            other_scanner: Count::default(),
            off_grid: Count::default(),
            misnumbered: Count::default(),
            lost: 0,
            progresses: 0,
            invalid_progress: Count::default(),
            braked: 0,
            episodes: Vec::new(),
            health: None,
            healths: 0,
            unaccounted: Count::default(),
            heard_ns: None,
            silent_ns: 0,
            misdated: Count::default(),
            timings: 0,
            timed: 0,
        }
    }

    /// A world is started: its predecessor's ticks and health are none of its own. What
    /// was found stays.
    pub(super) fn begin(&mut self) {
        self.seen.clear();
        self.health = None;
        self.heard_ns = None;
    }

    /// The newest observation.
    pub(super) fn newest(&self) -> Option<&Seen> {
        self.seen.last()
    }

    /// The speed of the newest observation, m/s.
    pub(super) fn speed_mps(&self) -> f64 {
        self.newest().map_or(0.0, |seen| seen.speed_mps)
    }

    /// Takes an observation that was read at `now`.
    pub(super) fn see(&mut self, observation: &Observation, now: Instant) {
        self.observations += 1;
        if let Err(refusal) = observation.check() {
            self.invalid.note(|| refusal.to_string());
            return;
        }
        if let Some(difference) = difference(&self.scanner, observation) {
            self.other_scanner.note(|| difference);
        }
        let header = observation.header;
        let released = Instant(observation.released_ns);
        // By the world's own instant, so that a delay of this reader changes nothing.
        if released > now {
            self.off_grid.note(|| "released in the future".into());
        } else if let Err(refusal) = self.grid.admit(observation, released.max(header.taken())) {
            self.off_grid.note(|| refusal.to_string());
        }
        let seen = Seen {
            tick: header.tick,
            episode: header.episode,
            scheduled_ns: observation.scheduled_ns,
            released_ns: observation.released_ns,
            heading_rad: observation.ego.heading_world_rad,
            yaw_rate_radps: observation.ego.yaw_rate_radps,
            speed_mps: observation.ego.speed_mps,
        };
        if let Some(last) = self.seen.last() {
            if last.tick == seen.tick && last.scheduled_ns == seen.scheduled_ns {
                return;
            }
            let instants = seen.scheduled_ns.saturating_sub(last.scheduled_ns) / self.period_ns;
            let ticks = seen.tick.saturating_sub(last.tick);
            if ticks == 0 || ticks != instants || seen.episode < last.episode {
                self.misnumbered.note(|| {
                    format!(
                        "tick {} follows {}, {instants} instants later",
                        seen.tick, last.tick
                    )
                });
            }
        }
        self.seen.push(seen);
    }

    /// Takes a progress message.
    pub(super) fn progress(&mut self, progress: &Progress) {
        self.progresses += 1;
        match progress.check() {
            Ok(()) => self.braked = progress.braked,
            Err(refusal) => self.invalid_progress.note(|| refusal.to_string()),
        }
    }

    /// Takes a health message that arrived by `now`.
    pub(super) fn hear(&mut self, health: Health, now: Instant) {
        self.healths += 1;
        let taken_ns = health.header.taken_ns;
        let apart_ns = now.0.abs_diff(taken_ns);
        if apart_ns > DATED_NS {
            self.misdated
                .note(|| format!("dated {:.1} s from its arrival", apart_ns as f64 * 1e-9));
        }
        if let Some(heard_ns) = self.heard_ns.replace(taken_ns) {
            self.silent_ns = self.silent_ns.max(taken_ns.saturating_sub(heard_ns));
        }
        let elapsed_ns = health
            .next_scheduled_ns
            .saturating_sub(health.first_scheduled_ns);
        let counted = health.ticks.saturating_add(health.skipped);
        if elapsed_ns.checked_div(self.period_ns) != Some(counted)
            || !elapsed_ns.is_multiple_of(self.period_ns)
        {
            self.unaccounted.note(|| {
                format!(
                    "{} ticks + {} skipped in {:.3} s",
                    health.ticks,
                    health.skipped,
                    elapsed_ns as f64 * 1e-9
                )
            });
        }
        self.health = Some(health);
    }
}
