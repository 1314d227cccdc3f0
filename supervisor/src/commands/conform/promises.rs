//! The promises of a world, each tested once.

use rustix::process::Signal;
use shm_config::message::{Outcome, RefusalKind};

use super::order::{Hostile, Order};
use super::pace::STAY_S;
use super::report::Report;
use super::rig::Rig;
use super::watched::Seen;
use crate::cli::failure::Failure;
use crate::set::exit::Exit;
use crate::set::launch::Resume;
use crate::set::member::READY_LIMIT_NS;

/// Time in which a car reaches the speed of the test, s: the delay until its engine pulls,
/// and a course that is uphill.
const SPEED_UP_S: f64 = 8.0;
/// Time for which a car was slow that stands, ns: one that rocks on its springs is slow for
/// a moment, too.
const STEADY_NS: u64 = 500_000_000;
/// Time in which a car stands beyond what braking takes, s: its brakes build up, it rocks
/// back, and it is seen to be steady.
const STAND_S: f64 = 2.5;
/// Steering of the test, normalised.
const STEER: f64 = 0.3;
/// Time over which the turning rate is taken, s.
const TURN_S: f64 = 0.6;
/// How often it is taken until the car turns as it is told: on a busy machine the scripted
/// controller is late.
const TURNS: usize = 4;
/// A turning rate that counts, rad/s.
const TURNS_RADPS: f64 = 0.02;
/// Time for which a count is awaited that did not rise yet, s: the sender may be late.
const LATE_S: f64 = 2.0;
/// Time after which the car is released again when a foreign process has ended, s: the
/// world brakes one second longer, then a command and the engine need theirs.
const RELEASE_S: f64 = 6.0;
/// The episode at which the killed world is started again.
const RESUMED: u32 = 5;

type Tested = Result<(), Failure>;

/// The world becomes ready.
pub(super) fn ready(rig: &mut Rig, report: &mut Report) -> Result<bool, Failure> {
    let promise = "becomes ready";
    let limit_s = READY_LIMIT_NS as f64 * 1e-9;
    let begun = rig.now();
    rig.start_world(Resume::default())?;
    match rig.watch(limit_s, |rig| Ok(rig.is_ready())) {
        Ok(is_ready) => {
            let took_s = rig.now().since_ns(begun) as f64 * 1e-9;
            let figure = match is_ready {
                true => format!("{took_s:.2} s; limit {limit_s} s"),
                false => format!("not in {limit_s} s: {}", rig.last_lines()),
            };
            report.add(promise, is_ready, figure);
            Ok(is_ready)
        }
        Err(Failure::GivenUp(why)) => {
            report.add(promise, false, why);
            Ok(false)
        }
        Err(other) => Err(other),
    }
}

/// It obeys the pedal: it drives, up to the speed of the test.
pub(super) fn obeys_pedal(rig: &mut Rig, report: &mut Report) -> Result<bool, Failure> {
    let promise = "obeys the pedal";
    rig.start_controller()?;
    // The first observations; the speed of a car that was dropped settles.
    rig.watch_for(0.5)?;
    let before_mps = rig.watched.speed_mps();
    let begun = rig.now();
    let is_fast = speed_up(rig)?;
    let took_s = rig.now().since_ns(begun) as f64 * 1e-9;
    let speed_mps = rig.watched.speed_mps();
    let figure = format!("{before_mps:.2} to {speed_mps:.2} m/s in {took_s:.1} s");
    let stood = before_mps.abs() < rig.pace.speed_mps / 4.0;
    report.add(promise, is_fast && stood, figure);
    Ok(is_fast)
}

/// Drives straight until the car has the speed of the test.
fn speed_up(rig: &mut Rig) -> Result<bool, Failure> {
    rig.watch(SPEED_UP_S + rig.pace.reach_s, |rig| {
        rig.order(Order::Drive(0.0, 1.0))?;
        Ok(rig.watched.speed_mps() >= rig.pace.speed_mps)
    })
}

/// Holds the speed of the test with a steering.
fn hold(rig: &mut Rig, steer: f64, time_s: f64) -> Tested {
    rig.watch(time_s, |rig| {
        // In steps, so that the controller is not given a new order at each look.
        let pedal = match rig.watched.speed_mps() {
            slow if slow < 0.8 * rig.pace.speed_mps => 0.5,
            slow if slow < rig.pace.speed_mps => 0.2,
            _ => 0.0,
        };
        rig.order(Order::Drive(steer, pedal))?;
        Ok(false)
    })
    .map(drop)
}

/// It steers to the side that it is told, and reports the turning rate with this sign.
pub(super) fn obeys_steering(rig: &mut Rig, report: &mut Report) -> Tested {
    let promise = "steers left for positive steering";
    let rates = [STEER, -STEER].map(|steer| -> Result<(f64, f64), Failure> {
        speed_up(rig)?;
        hold(rig, steer, TURN_S + rig.pace.delay_s)?;
        let mut turned = (0.0, 0.0);
        for _ in 0..TURNS {
            let from = rig.watched.seen.len();
            hold(rig, steer, TURN_S)?;
            turned = turning(rig.watched.seen.get(from..).unwrap_or_default());
            if turned.0 * steer.signum() > TURNS_RADPS {
                break;
            }
        }
        Ok(turned)
    });
    let [left, right] = rates;
    let ((left, left_told), (right, right_told)) = (left?, right?);
    let turns = left > TURNS_RADPS && right < -TURNS_RADPS;
    report.add(promise, turns, format!("{left:+.3} and {right:+.3} rad/s"));
    let is_told = left * left_told > 0.0 && right * right_told > 0.0;
    let figure = format!("{left_told:+.3} and {right_told:+.3} rad/s");
    report.add("reports the turning rate", is_told, figure);
    Ok(())
}

/// The mean turning rate by the headings, and the mean of those reported, rad/s.
fn turning(seen: &[Seen]) -> (f64, f64) {
    let mut turned_rad = 0.0;
    let mut time_s = 0.0;
    for pair in seen.windows(2) {
        let [one, next] = pair else { continue };
        if one.episode != next.episode {
            continue;
        }
        let step_rad = next.heading_rad - one.heading_rad;
        // Headings wrap at half a turn, and no car turns by one in a tick.
        turned_rad += step_rad.sin().atan2(step_rad.cos());
        time_s += next.scheduled_ns.saturating_sub(one.scheduled_ns) as f64 * 1e-9;
    }
    let told: f64 = seen.iter().map(|seen| seen.yaw_rate_radps).sum();
    match (time_s > 0.0, seen.len()) {
        (true, count) => (turned_rad / time_s, told / count as f64),
        (false, _) => (0.0, 0.0),
    }
}

/// It brakes to a stand when commands stop, and stays there.
pub(super) fn brakes_on_silence(rig: &mut Rig, report: &mut Report) -> Tested {
    let is_fast = speed_up(rig)?;
    let before = rig.watched.braked;
    let speed_mps = rig.watched.speed_mps();
    let (stands, figure) = stand(rig, |rig| rig.order(Order::Silence))?;
    let promise = "brakes when commands stop";
    report.add(
        promise,
        stands && is_fast,
        format!("{speed_mps:.1} m/s {figure}"),
    );
    let fastest_mps = stay(rig)?;
    let limit_mps = rig.pace.stays_mps;
    let held = stands && fastest_mps < limit_mps;
    let figure = format!("at most {fastest_mps:.2} m/s; limit {limit_mps:.2} m/s");
    report.add("stays at a stand without commands", held, figure);
    let braked = rig.watched.braked.saturating_sub(before);
    let figure = format!("{braked} more ticks");
    report.add(
        "counts the ticks braked without a command",
        braked > 0,
        figure,
    );
    Ok(())
}

/// Does something that the car has to brake for; whether it stands in time, and when.
fn stand(rig: &mut Rig, begin: impl FnOnce(&mut Rig) -> Tested) -> Result<(bool, String), Failure> {
    let age_s = rig.config.limits.command_age_ms * 1e-3;
    // The last command was sent up to a period before, and the car moves at the grid.
    let limit_s = age_s + 2.0 / rig.config.run.rate_hz + rig.pace.brake_s + STAND_S;
    let begun = rig.now();
    begin(rig)?;
    let stands = rig.watch(limit_s, |rig| Ok(is_standing(rig)))?;
    let took_s = rig.now().since_ns(begun) as f64 * 1e-9;
    Ok(match stands {
        true => (
            true,
            format!("to a stand in {took_s:.2} s; limit {limit_s:.2} s"),
        ),
        false => {
            let speed_mps = rig.watched.speed_mps();
            (
                false,
                format!("to {speed_mps:.1} m/s in {limit_s:.2} s, its limit"),
            )
        }
    })
}

fn is_standing(rig: &Rig) -> bool {
    let seen = &rig.watched.seen;
    let newest_ns = seen.last().map_or(0, |seen| seen.scheduled_ns);
    let mut lately = seen
        .iter()
        .rev()
        .take_while(|seen| seen.scheduled_ns + STEADY_NS >= newest_ns);
    lately.all(|seen| seen.speed_mps.abs() < rig.pace.stands_mps)
}

/// Lets the car come to a stand, which is no promise of its own.
pub(super) fn stands(rig: &mut Rig) -> Tested {
    stand(rig, |rig| rig.order(Order::Silence)).map(drop)
}

/// The greatest speed while the car has to stay at a stand, m/s.
fn stay(rig: &mut Rig) -> Result<f64, Failure> {
    let mut fastest_mps: f64 = 0.0;
    rig.watch(STAY_S + rig.pace.delay_s, |rig| {
        fastest_mps = fastest_mps.max(rig.watched.speed_mps().abs());
        Ok(false)
    })?;
    Ok(fastest_mps)
}

/// It obeys no command that is invalid, and counts them.
pub(super) fn refuses(rig: &mut Rig, report: &mut Report) -> Tested {
    for kind in Hostile::ALL {
        let (promise, counted) = match kind {
            Hostile::Nan => (
                "refuses a command whose steering is NaN",
                RefusalKind::Content,
            ),
            Hostile::Range => ("refuses a command with a pedal of 7", RefusalKind::Content),
            Hostile::Stale => ("refuses a command a minute old", RefusalKind::Stale),
            Hostile::Future => ("refuses a command a minute ahead", RefusalKind::Future),
            Hostile::Episode => ("refuses a command of another episode", RefusalKind::Episode),
        };
        let (stands, figure) = stand(rig, |rig| rig.order(Order::Silence))?;
        let before = rig.refused(counted);
        rig.order(Order::Hostile(kind))?;
        await_refusal(rig, counted, before)?;
        let fastest_mps = stay(rig)?;
        let refused = rig.refused(counted).saturating_sub(before);
        let held = stands && fastest_mps < rig.pace.stays_mps && refused > 0;
        let figure = match stands {
            true => format!("at most {fastest_mps:.2} m/s, {refused} refused"),
            false => figure,
        };
        report.add(promise, held, figure);
    }
    rig.order(Order::Silence)
}

/// Waits until the world has refused a message for this reason, so that the car is watched
/// while the messages come.
fn await_refusal(rig: &mut Rig, kind: RefusalKind, before: u64) -> Tested {
    rig.watch(LATE_S, |rig| Ok(rig.refused(kind) > before))
        .map(drop)
}

/// It brakes while a process that the run did not start sends commands too.
pub(super) fn brakes_while_contested(rig: &mut Rig, report: &mut Report) -> Tested {
    let is_fast = speed_up(rig)?;
    let before = rig.refused(RefusalKind::Foreign);
    let (stands, figure) = stand(rig, |rig| rig.start_stranger(Order::Drive(0.0, 1.0)))?;
    await_refusal(rig, RefusalKind::Foreign, before)?;
    let fastest_mps = stay(rig)?;
    let refused = rig.refused(RefusalKind::Foreign).saturating_sub(before);
    rig.end_stranger();
    let held = is_fast && stands && fastest_mps < rig.pace.stays_mps && refused > 0;
    let figure = format!("{figure}; then at most {fastest_mps:.2} m/s; {refused} refused");
    report.add("brakes while a foreign process sends", held, figure);
    let begun = rig.now();
    let limit_s = RELEASE_S + rig.pace.reach_s;
    let drives = rig.watch(limit_s, |rig| {
        rig.order(Order::Drive(0.0, 1.0))?;
        Ok(rig.watched.speed_mps() > rig.pace.speed_mps / 2.0)
    })?;
    let took_s = rig.now().since_ns(begun) as f64 * 1e-9;
    let figure = format!("after {took_s:.1} s; limit {limit_s:.1} s");
    report.add("drives on when that process has ended", drives, figure);
    Ok(())
}

/// It brakes when the controller dies, and obeys its successor.
pub(super) fn survives_controller(rig: &mut Rig, report: &mut Report) -> Tested {
    let is_fast = speed_up(rig)?;
    let (stands, figure) = stand(rig, |rig| {
        rig.kill_controller();
        Ok(())
    })?;
    report.add(
        "brakes when the controller is killed",
        stands && is_fast,
        figure,
    );
    rig.start_controller()?;
    let begun = rig.now();
    let is_fast = speed_up(rig)?;
    let took_s = rig.now().since_ns(begun) as f64 * 1e-9;
    let speed_mps = rig.watched.speed_mps();
    let figure = format!("{speed_mps:.1} m/s after {took_s:.1} s");
    report.add("obeys the restarted controller", is_fast, figure);
    rig.order(Order::Silence)
}

/// What it published until now was valid, complete and on the grid.
pub(super) fn publishes(rig: &Rig, report: &mut Report) {
    let watched = &rig.watched;
    let count = watched.observations;
    let none = |of: &super::watched::Count| of.count == 0 && count > 0;
    report.add(
        "observations are valid",
        none(&watched.invalid),
        watched.invalid.of(count),
    );
    report.add(
        "shows the scanner of the run",
        none(&watched.other_scanner),
        watched.other_scanner.of(count),
    );
    report.add(
        "observations are on the grid",
        none(&watched.off_grid),
        watched.off_grid.of(count),
    );
    report.add(
        "tick numbers follow the grid",
        none(&watched.misnumbered),
        watched.misnumbered.of(count),
    );
    on_time(rig, report);
    accounted(rig, report);
    let held = watched.progresses > 0 && watched.invalid_progress.count == 0;
    let figure = format!(
        "{} invalid",
        watched.invalid_progress.of(watched.progresses)
    );
    report.add("publishes progress", held, figure);
    let limit_s = rig.config.supervisor.silence_s;
    let silent_s = watched.silent_ns as f64 * 1e-9;
    let figure = format!(
        "{} messages, at most {silent_s:.2} s apart; limit {limit_s} s; {} misdated",
        watched.healths,
        watched.misdated.of(watched.healths)
    );
    let is_dated = watched.misdated.count == 0;
    report.add(
        "publishes health",
        watched.healths > 1 && silent_s < limit_s && is_dated,
        figure,
    );
    let figure = format!(
        "{} messages, the newest of {} ticks",
        watched.timings, watched.timed
    );
    report.add(
        "publishes timing",
        watched.timings > 0 && watched.timed > 0,
        figure,
    );
}

/// It begins its ticks near their instants.
fn on_time(rig: &Rig, report: &mut Report) {
    let promise = "is on time at half of its ticks";
    let late = |seen: &Seen| seen.released_ns.saturating_sub(seen.scheduled_ns) as f64 * 1e-6;
    let mut late_ms: Vec<f64> = rig.watched.seen.iter().map(late).collect();
    late_ms.sort_unstable_by(f64::total_cmp);
    let Some(greatest_ms) = late_ms.last() else {
        return report.skip(promise, "no valid observation");
    };
    let at = |share: f64| {
        let place = (late_ms.len() as f64 * share) as usize;
        late_ms.get(place).unwrap_or(greatest_ms)
    };
    // The controller waits half a period for an observation.
    let limit_ms = 500.0 / rig.config.run.rate_hz;
    let (median_ms, most_ms) = (at(0.5), at(0.99));
    let figure = format!(
        "median {median_ms:.2} ms late, 99 % {most_ms:.2} ms, greatest {greatest_ms:.2} ms; \
         limit {limit_ms} ms"
    );
    report.add(promise, *median_ms < limit_ms, figure);
}

/// Each instant of the grid is a tick or counted as skipped, and each tick was published.
fn accounted(rig: &Rig, report: &mut Report) {
    let watched = &rig.watched;
    let Some(health) = &watched.health else {
        return report.skip("accounts for each instant", "no health message");
    };
    let published = watched.seen.len() as u64 + watched.lost;
    // The newest observation may be read after the health message that counts it.
    let all_are_there = published + 2 >= health.ticks;
    let held = watched.unaccounted.count == 0 && all_are_there && health.ticks > 0;
    let figure = match &watched.unaccounted.first {
        Some(first) => format!(
            "{} messages do not add up; {first}",
            watched.unaccounted.count
        ),
        None => format!(
            "{} ticks + {} skipped as due; {published} observations",
            health.ticks, health.skipped
        ),
    };
    report.add("accounts for each instant", held, figure);
}

/// Killed and started again, it goes on at the episode that it is told.
pub(super) fn resumes(rig: &mut Rig, report: &mut Report) -> Tested {
    let promise = "is restarted at its episode, on the same grid";
    let killed_mps = rig.watched.speed_mps();
    rig.signal_world(Signal::KILL);
    let limit_s = READY_LIMIT_NS as f64 * 1e-9;
    let until = rig.now().after_ns(READY_LIMIT_NS);
    while rig.world_exit().is_none() && rig.now() < until {
        crate::machine::signals::pause(std::time::Duration::from_millis(2));
    }
    let off_grid = rig.watched.off_grid.count;
    rig.start_world(Resume {
        episode: RESUMED,
        driven_ns: 1_000_000_000,
    })?;
    let is_there = rig.watch(limit_s, |rig| Ok(rig.watched.newest().is_some()))?;
    let episode = rig.watched.newest().map(|seen| seen.episode);
    let is_on_grid = rig.watched.off_grid.count == off_grid;
    let figure = match episode {
        Some(episode) => format!("episode {episode} of {RESUMED}; killed at {killed_mps:.2} m/s"),
        None => format!("no observation in {limit_s} s"),
    };
    let held = is_there && is_on_grid && episode == Some(RESUMED);
    report.add(promise, held, figure);
    Ok(())
}

/// Asked to end, it closes its episode and ends with exit code 0.
pub(super) fn ends(rig: &mut Rig, report: &mut Report) -> Tested {
    let limit_s = rig.config.supervisor.stop_s;
    rig.watched.episodes.clear();
    let begun = rig.now();
    rig.signal_world(Signal::TERM);
    let until = begun.after_ns((limit_s * 1e9) as u64);
    let mut exit = None;
    while exit.is_none() && rig.now() < until {
        exit = rig.world_exit();
        crate::machine::signals::pause(std::time::Duration::from_millis(2));
    }
    let took_s = rig.now().since_ns(begun) as f64 * 1e-9;
    let (held, figure) = match &exit {
        None => (false, format!("it runs after {limit_s} s")),
        Some(exit) => {
            let figure = format!("{exit} after {took_s:.2} s; limit {limit_s} s");
            (*exit == Exit::Done, figure)
        }
    };
    report.add("ends with exit code 0 when asked", held, figure);
    let last = rig.watched.episodes.last();
    let figure = match last {
        Some(episode) => format!("{}, {} ticks", episode.outcome(), episode.ticks),
        None => "none".into(),
    };
    let held = last.is_some_and(|episode| episode.outcome() == Outcome::Stopped);
    report.add("publishes the episode that it ends", held, figure);
    Ok(())
}
