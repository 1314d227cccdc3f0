//! What another planner, limit or judge would have said at each recorded tick, in open loop:
//! the state before the tick and its observation are the recorded ones.

use std::collections::VecDeque;
use std::path::Path;

use comfy_table::Table;
use controller::Recomputer;
use planner::Planner;
use plotters::prelude::*;
use serde::Serialize;
use shm_config::Instant;
use shm_config::config::{Clock as RunClock, Config};
use shm_config::message::{Advice, Driver, Message, Plan, Step};
use view::chart::{FAINT, INK, write};
use view::sheet::{Area, save_svg};

use super::messages::AnyMessage;
use super::source::Source;
use crate::fork::drive::advisor;
use crate::report::table;

/// Size of the plot, pixels.
const SIZE: (u32, u32) = (1360, 640);
/// Plans that are kept for the ticks that read them late.
const MADE: usize = 64;
/// Steering or pedal that differs by more is another action.
const SAME: f64 = 1e-9;

/// One tick, as it was and as it would have been.
#[derive(Clone, Debug, Serialize)]
pub struct Pair {
    /// The tick.
    pub tick: u64,
    /// Its episode.
    pub episode: u32,
    /// As recorded.
    pub recorded: Said,
    /// With the change.
    pub other: Said,
}

/// What a tick decided.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Said {
    /// The driver.
    pub driver: &'static str,
    /// Why.
    pub reason: &'static str,
    /// Steering, [-1, 1].
    pub steer: f64,
    /// Pedal, [-1, 1].
    pub pedal: f64,
    /// Whether the expert's proposal was vetoed.
    pub expert_veto: bool,
    /// Whether the policy's was.
    pub policy_veto: bool,
}

impl Said {
    fn of(step: &Step) -> Self {
        Self {
            driver: step.driver().word(),
            reason: step.reason().map_or("unknown", |reason| reason.word()),
            steer: step.command.steer,
            pedal: step.command.pedal,
            expert_veto: step.expert_assessment.is_vetoed(),
            policy_veto: step.policy_assessment.is_vetoed(),
        }
    }
}

/// The recorded ticks with a change.
#[derive(Clone, Debug, Serialize)]
pub struct Asked {
    /// Ticks that were asked.
    pub ticks: u64,
    /// Ticks with another action, driver or reason.
    pub different: u64,
    /// The ticks.
    pub pairs: Vec<Pair>,
}

/// Asks at each recorded tick from `from` on, or at one alone.
///
/// # Errors
/// When the recording cannot be read or the configuration is refused.
pub fn ask(
    source: &mut dyn Source,
    config: &Config,
    (from, only): (u64, Option<u64>),
) -> anyhow::Result<Asked> {
    let recorded = source.config().clone();
    let mut lockstep = config.clone();
    lockstep.run.clock = RunClock::Lockstep;
    let mut planner = match plans_differ(&recorded, config) {
        true => Some(Planner::new(&lockstep)?),
        false => None,
    };
    let mut judge = match recorded.gate == config.gate {
        true => None,
        false => advisor(config),
    };
    let mut recomputer = Recomputer::new(config);
    let mut made: VecDeque<(u64, Plan)> = VecDeque::new();
    let mut advice: Option<Advice> = None;
    let mut pairs = Vec::new();
    while let Some(message) = source.next()? {
        let AnyMessage::Step(step) = message else {
            continue;
        };
        let mut other = step;
        let observation = step.observation.header();
        if let Some(planner) = &mut planner {
            if made
                .back()
                .is_none_or(|(taken_ns, _)| *taken_ns != observation.taken_ns)
            {
                let mut plan = Plan::default();
                planner.plan(&step.observation, &mut plan);
                made.push_back((observation.taken_ns, plan));
                if made.len() > MADE {
                    made.pop_front();
                }
            }
            let wanted = step.plan.header;
            if let Some((_, plan)) = made
                .iter()
                .find(|(taken_ns, _)| *taken_ns == wanted.taken_ns)
            {
                // It comes when the recorded one came.
                other.plan = *plan;
                other.plan.header = wanted;
            }
        }
        if let Some(advice) = advice.filter(|_| judge.is_some()) {
            other.advice = advice;
            other.before.has_advice = 1;
        }
        let again = *recomputer.recompute(&other);
        if let Some(judge) = &mut judge {
            advice = Some(judge.consider(&again, Instant(step.header.taken_ns)));
        }
        let tick = step.header.tick;
        if tick >= from && only.is_none_or(|only| only == tick) {
            pairs.push(Pair {
                tick,
                episode: step.header.episode,
                recorded: Said::of(&step),
                other: Said::of(&again),
            });
        }
    }
    Ok(Asked {
        ticks: pairs.len() as u64,
        different: pairs.iter().filter(|pair| !pair.is_same()).count() as u64,
        pairs,
    })
}

/// Whether plans of these configurations may differ.
fn plans_differ(recorded: &Config, config: &Config) -> bool {
    (recorded.planner, recorded.informed) != (config.planner, config.informed)
        || (recorded.kinodynamic, recorded.mpc) != (config.kinodynamic, config.mpc)
}

impl Pair {
    fn is_same(&self) -> bool {
        let (a, b) = (&self.recorded, &self.other);
        let is_near = |a: f64, b: f64| (a - b).abs() < SAME;
        let same_action = is_near(a.steer, b.steer) && is_near(a.pedal, b.pedal);
        same_action && (a.driver, a.reason) == (b.driver, b.reason)
    }
}

impl Asked {
    /// The figures side by side.
    pub fn table(&self) -> Table {
        let mut rows = table(&["", "recorded", "with the change"]);
        let mut count = |name: &str, has: &dyn Fn(&Said) -> bool| {
            let recorded = self.pairs.iter().filter(|pair| has(&pair.recorded)).count();
            let other = self.pairs.iter().filter(|pair| has(&pair.other)).count();
            rows.add_row([name.to_string(), recorded.to_string(), other.to_string()]);
        };
        for driver in Driver::ALL {
            let name = format!("ticks driven by {driver}");
            count(&name, &|said| said.driver == driver.word());
        }
        count("expert vetoed", &|said| said.expert_veto);
        count("policy vetoed", &|said| said.policy_veto);
        let apart = |value: fn(&Said) -> f64| {
            let pairs = self.pairs.iter();
            let apart = pairs.map(|pair| (value(&pair.recorded) - value(&pair.other)).abs());
            let (sum, most) = apart.fold((0.0, 0.0_f64), |(sum, most), a| (sum + a, most.max(a)));
            let mean = sum / self.pairs.len().max(1) as f64;
            format!("{mean:.3}, at most {most:.3}")
        };
        let steer = apart(|said| said.steer);
        let pedal = apart(|said| said.pedal);
        rows.add_row(["steering apart".to_string(), String::new(), steer]);
        rows.add_row(["pedal apart".to_string(), String::new(), pedal]);
        let different = format!("{} of {}", self.different, self.ticks);
        rows.add_row(["ticks that differ".to_string(), String::new(), different]);
        rows
    }

    /// Draws steering and pedal of both over the ticks, SVG.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn plot(&self, file: &Path) -> anyhow::Result<()> {
        save_svg(file, SIZE, |root: &Area<'_>| self.paint(root))
    }

    fn paint(&self, root: &Area<'_>) -> anyhow::Result<()> {
        type Value = fn(&Said) -> f64;
        type Side = fn(&Pair) -> &Said;
        let panels: [(&str, Value); 2] = [
            ("steering", |said| said.steer),
            ("pedal", |said| said.pedal),
        ];
        for (area, (name, value)) in root.split_evenly((2, 1)).into_iter().zip(panels) {
            let last = self.pairs.len().max(1) as f64;
            let mut chart = ChartBuilder::on(&area)
                .margin(40)
                .build_cartesian_2d(0.0..last, -1.05..1.05)?;
            chart.draw_series(LineSeries::new([(0.0, 0.0), (last, 0.0)], FAINT))?;
            let colours: [(RGBColor, Side); 2] = [
                (RGBColor(31, 105, 178), |pair| &pair.recorded),
                (RGBColor(211, 84, 0), |pair| &pair.other),
            ];
            for (colour, of) in colours {
                let points = self.pairs.iter().enumerate();
                let line = points.map(|(at, pair)| (at as f64, value(of(pair))));
                chart.draw_series(LineSeries::new(line, colour))?;
            }
            let words = format!("{name}: recorded blue, with the change orange");
            write(&area, &words, (40, 12), (18, INK))?;
        }
        Ok(())
    }
}
