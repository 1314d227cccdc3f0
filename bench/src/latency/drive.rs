//! Measures one row: a set under load, the machine's floor, and the set's steps.

use std::path::Path;
use std::time::Duration;

use anyhow::bail;
use serde_json::Value;
use shm_config::config::{Config, Keep};
use shm_config::run::{RunName, RunPaths};

use super::Bench;
use super::arguments::Case;
use super::buckets::{self, Series};
use super::cyclictest::Cyclictest;
use super::judges::RowJudge;
use super::link::RowLink;
use super::recording::{CoreShare, Recorded, SPACE};
use super::ros::RowRos;
use super::row::{Row, planner};
use super::stress::Stress;
use super::viewers::RowPage;
use super::watch::Watch;
use crate::driven::{Driven, Punctuality, quantiles};
use crate::floor::{Floor, Priority, claim};
use crate::stalls::{StallWatch, Stalls};
use supervisor::subcommand::settings;

/// Time limit for a set to start driving, ns.
const START_NS: u64 = 60_000_000_000;
/// Polling interval of the steps: short enough that their queue does not overflow.
const LOOK: Duration = Duration::from_millis(20);
/// Seconds between two updates by the learner.
const BLOCK_S: f64 = 2.0;

/// Drives one row; `None` if a stop is requested meanwhile. `k` makes the run's name
/// unique, so that a row does not depend on what an earlier one left.
pub fn drive(
    bench: &Bench<'_>,
    case: &Case,
    k: usize,
) -> anyhow::Result<Option<(Row, Vec<Series>)>> {
    let run = format!("latency-{k}");
    let mut judges = Judges {
        here: case.beside.judge.begin()?,
        elsewhere: RowLink::invite(case.beside.link, (&run, bench.scratch))?,
    };
    let config = configuration(bench, case)?;
    let plan_rate_hz = config.planner_rate_hz();
    let mut up = judges.arguments();
    up.extend(arguments(bench, case));
    let variable = judges.elsewhere.as_ref().map(RowLink::environment);
    let mut driven = Driven::start_with(&run, up, variable)?;
    let Some(mut watch) = await_start(bench, &mut driven)? else {
        return Ok(None);
    };
    let seconds = bench.settings.seconds;
    let places = (bench.scratch, bench.disk);
    let mut stress = Stress::begin(&case.beside, (bench.maker, seconds), places)?;
    let place = (driven.name(), bench.scratch);
    let page = RowPage::start(case.beside.viewers, place, bench.clock)?;
    let ros = RowRos::start(case.beside.ros, place)?;
    judges.join()?;
    let noting = StallWatch::start(case.priority, bench.clock)?;
    let mut share = CoreShare::default();
    let set = (&mut driven, &mut watch, &mut judges);
    let counted = follow(bench, case, set, &mut share)?;
    // An interrupted row is discarded, even if the set has ended by itself.
    if bench.stop.is_asked() {
        return Ok(None);
    }
    stress.check()?;
    drop(stress);
    let stalls = noting.finish()?;
    page.map(RowPage::finish).transpose()?;
    let expected = (case.rate_hz, seconds);
    ros.map(|ros| ros.finish(expected)).transpose()?;
    watch.look();
    let seen = watch.finish();
    let summary = driven.summary()?;
    let Some(counted) = counted else {
        bail!("the set never drove");
    };
    judges.check(&driven, expected)?;
    let mut series = of_run(&driven.run_folder())?;
    series.extend(counted.series);
    let (misses, latest) = seen.beside(&stalls);
    let controller = Punctuality::of(&summary, "controller");
    let row = Row {
        rate_hz: case.rate_hz,
        beside: case.beside.name.into(),
        priority: case.priority_word().into(),
        settings: bench.settings.clone(),
        questions: judges.here.questions(),
        weights: seen.weights,
        restarts: summary["restarts"].as_u64().unwrap_or(0),
        plan_rate_hz,
        world: Punctuality::of(&summary, "world"),
        planner: planner(&summary, &controller, plan_rate_hz),
        response_us: quantiles(&summary["processes"]["controller"], "response_us"),
        controller,
        cpu_latency: summary["cpu_latency"].as_str().unwrap_or("unknown").into(),
        floor_by: counted.by.into(),
        floor: counted.floor,
        own_floor: counted.own,
        recording: recorded(&config, &driven, (&summary, &share))?,
        misses,
        latest,
        stalls_us: longest(&stalls),
    };
    row.check_accounts()?;
    Ok(Some((row, series)))
}

/// The recording of a finished row; `None` when its configuration asks for none.
fn recorded(
    config: &Config,
    driven: &Driven,
    (summary, share): (&Value, &CoreShare),
) -> anyhow::Result<Option<Recorded>> {
    if config.keeps() != Keep::Everything {
        return Ok(None);
    }
    let folder = match &config.record.folder[..] {
        "" => driven.run_folder().join("recording"),
        named => driven.folder().join(named),
    };
    let lost = summary["processes"]["recorder"]["lost"].as_u64();
    Recorded::read(&folder, lost.unwrap_or(0), share.share()).map(Some)
}

/// Who judges in a row.
struct Judges {
    here: RowJudge,
    elsewhere: Option<RowLink>,
}

impl Judges {
    /// Arguments of `./vlaps up`.
    fn arguments(&self) -> Vec<String> {
        match &self.elsewhere {
            Some(link) => link.arguments(),
            None => self.here.arguments(),
        }
    }

    /// Lets a judge elsewhere join.
    fn join(&mut self) -> anyhow::Result<()> {
        self.elsewhere.as_mut().map(RowLink::join).transpose()?;
        Ok(())
    }

    /// Called at half of the run.
    fn half_way(&mut self) {
        self.here.half_way();
        if let Some(link) = &mut self.elsewhere {
            link.half_way();
        }
    }

    /// Checks that a judge elsewhere was there.
    fn check(&self, driven: &Driven, expected: (f64, f64)) -> anyhow::Result<()> {
        match &self.elsewhere {
            Some(link) => link.check(&driven.run_folder(), expected),
            None => Ok(()),
        }
    }
}

/// Waits until the set's processes are up; `None` if a stop is requested first.
fn await_start(bench: &Bench<'_>, driven: &mut Driven) -> anyhow::Result<Option<Watch>> {
    let name: RunName = driven.name().parse()?;
    let paths = RunPaths::new(name.clone());
    let until = (bench.clock)().after_ns(START_NS);
    while paths.supervisor_pid().is_none() {
        // Nothing drives yet. A signal to the whole process group may have reached the
        // set, too, before it moved to a group of its own.
        if bench.stop.is_asked() {
            return Ok(None);
        }
        if driven.has_ended()? || (bench.clock)() > until {
            driven.summary()?;
            bail!("the set does not start");
        }
        supervisor::machine::signals::pause(LOOK);
    }
    Watch::begin(&name).map(Some)
}

/// Watches the set until it ends, and measures the floor while it drives; `None` if it
/// never drove.
fn follow(
    bench: &Bench<'_>,
    case: &Case,
    (driven, watch, judges): (&mut Driven, &mut Watch, &mut Judges),
    share: &mut CoreShare,
) -> anyhow::Result<Option<FloorResult>> {
    let seconds = bench.settings.seconds;
    let (mut floors, mut counted) = (None, None);
    let (mut until, mut stopping) = (None, false);
    while !driven.has_ended()? {
        watch.look();
        let now = (bench.clock)();
        if let Some(pid) = watch.recorder_pid() {
            share.look(pid, now);
        }
        if watch.has_begun() && until.is_none() {
            until = Some(now.after_ns((seconds * 1e9) as u64));
            floors = Some(FloorMeasurement::start(bench, case)?);
        }
        if until.is_some_and(|until| until.since_ns(now) < (seconds * 0.5e9) as u64) {
            judges.half_way();
        }
        // Stopped before the processes end: the row does not include their end, either.
        if until.is_some_and(|until| now > until)
            && let Some(floors) = floors.take()
        {
            counted = Some(floors.finish(bench)?);
        }
        if bench.stop.is_asked() && !stopping {
            // Only once: a second signal would kill the set.
            driven.stop();
            stopping = true;
        }
        supervisor::machine::signals::pause(LOOK);
    }
    if let Some(floors) = floors.take().filter(|_| !bench.stop.is_asked()) {
        counted = Some(floors.finish(bench)?);
    }
    Ok(counted)
}

/// The floor measurements of one row, by every available program.
struct FloorMeasurement {
    cyclictest: Option<Cyclictest>,
    own: Floor,
}

/// Result of the floor measurements.
struct FloorResult {
    by: &'static str,
    floor: Punctuality,
    own: Punctuality,
    series: Vec<Series>,
}

impl FloorMeasurement {
    fn start(bench: &Bench<'_>, case: &Case) -> anyhow::Result<Self> {
        let (rate_hz, seconds) = (case.rate_hz, bench.settings.seconds);
        let cyclictest = match bench.cyclictest {
            true => Some(Cyclictest::start(rate_hz, granted(case.priority), seconds)?),
            false => None,
        };
        let own = Floor::start(rate_hz, case.priority, bench.clock)?;
        Ok(Self { cyclictest, own })
    }

    fn finish(self, bench: &Bench<'_>) -> anyhow::Result<FloorResult> {
        let counted = match self.cyclictest.map(Cyclictest::finish) {
            // If cyclictest fails, the thread of this program replaces it.
            Some(Err(_)) if !bench.insist => None,
            counted => counted.transpose()?,
        };
        let own = self.own.finish()?;
        let lateness = Series::of_histogram("own floor", "release_lateness", &own.lateness);
        let mut series = vec![lateness];
        let (by, floor) = match counted {
            Some((floor, lateness)) => {
                series.push(lateness);
                ("cyclictest", floor)
            }
            None => ("own thread", own.punctuality.clone()),
        };
        Ok(FloorResult {
            by,
            floor,
            own: own.punctuality,
            series,
        })
    }
}

fn longest(stalls: &Stalls) -> Vec<f64> {
    let largest = stalls.largest(5);
    largest.iter().map(|&(_, ns)| ns as f64 / 1e3).collect()
}

/// Requests the priority only where it is granted: cyclictest fails without it.
fn granted(priority: Priority) -> Priority {
    let asked = std::thread::spawn(move || claim(priority)).join();
    match asked {
        Ok("granted") => Priority::Asked,
        _ => Priority::Ordinary,
    }
}

/// The configuration of a row's set.
///
/// # Errors
/// If it is invalid.
pub fn configuration(bench: &Bench<'_>, case: &Case) -> anyhow::Result<Config> {
    let elsewhere = case.beside.link.arguments();
    let mut up = elsewhere.unwrap_or_else(|| case.beside.judge.arguments());
    up.extend(arguments(bench, case));
    settings::of_set(up)
}

fn arguments(bench: &Bench<'_>, case: &Case) -> Vec<String> {
    let mut up: Vec<String> = vec!["--seed".into(), "3".into()];
    // A policy that is offered at the start would replace a learner's first weights.
    if !case.beside.learner {
        up.extend(["--policy".into(), bench.policy.display().to_string()]);
    }
    up.extend(["--rate".into(), case.rate_hz.to_string()]);
    up.extend(["--duration".into(), bench.settings.seconds.to_string()]);
    if case.priority == Priority::Ordinary {
        up.push("--no-realtime".into());
    }
    let mut keys: Vec<String> = vec![SPACE.into()];
    if case.beside.recorder {
        up.push("--record".into());
    }
    if case.beside.learner {
        let block = (case.rate_hz * BLOCK_S).round();
        keys.extend([
            "learner.enabled=true".into(),
            "learner.algorithm=dagger".into(),
            format!("learner.block_steps={block}"),
            "learner.updates=50".into(),
            // Its weights are adopted and stay active, whichever actions they propose.
            "policy.shadow_ticks=0".into(),
            "policy.veto_rate_max=1.0".into(),
            "policy.jump_max=2.0".into(),
        ]);
    }
    for text in keys.iter().chain(&bench.settings.overrides) {
        up.extend(["--set".into(), text.clone()]);
    }
    up
}

/// The histograms of all processes, from the run's file.
fn of_run(folder: &Path) -> anyhow::Result<Vec<Series>> {
    let path = folder.join("timing.csv");
    match path.exists() {
        true => buckets::read(&path),
        false => Ok(Vec::new()),
    }
}
