#![doc = include_str!("../../../docs/services.md")]

#[cfg(feature = "std")]
mod pages;
mod row;

#[cfg(feature = "std")]
pub use pages::{markdown, picture};
pub use row::{
    AgeLimit, Delivery, Leaves, MessageType, Process, RECORDED_DEPTH, Rate, Recorded, Row, Service,
    TakenFrom, Times,
};

use crate::message::{
    Advice, Command, Episode, Fault, Foresight, Frame, FrameRequest, Health, Kept, Learning,
    Observation, Plan, PolicyStatus, Progress, Roster, Step, Takeover, Timing, Weights,
};

/// Steps that a slow reader may fall behind: over three minutes at 10 Hz, 23 MB. Twice as
/// many would not leave room for weights and pictures in a container's 64 MB.
pub const STEP_QUEUE: usize = 2048;
/// Episodes that a slow reader may fall behind.
pub const EPISODE_QUEUE: usize = 256;
/// Orders to fail that a slow reader may fall behind.
pub const FAULT_QUEUE: usize = 16;

/// The processes that the supervisor starts.
const STARTED: &[Process] = &[
    Process::World,
    Process::Planner,
    Process::Controller,
    Process::Gate,
    Process::Learner,
    Process::Recorder,
];

/// Names of a family: one for each process, in the order of their codes.
macro_rules! each_process {
    ($family:literal) => {
        &[
            concat!($family, "/supervisor"),
            concat!($family, "/world"),
            concat!($family, "/planner"),
            concat!($family, "/controller"),
            concat!($family, "/gate"),
            concat!($family, "/learner"),
            concat!($family, "/recorder"),
        ]
    };
}

/// Writes each row as a typed constant, and all rows as [`SERVICES`].
macro_rules! service_table {
    ( $(
        $(#[doc = $about:literal])+
        $(#[comment = $why:literal])?
        $name:ident: $message:ty = $service:literal $(of $instances:expr)?,
        $delivery:expr, from $taken_from:ident,
        $producers:expr, $(tools $tools:expr,)? => $consumers:expr, wakes $wakes:expr,
        $rate:expr, age $age:ident, recorded $recorded:ident, times $times:ident,
        leaves $leaves:ident;
    )+ ) => {
        $(
            $(#[doc = $about])+
            $(#[doc = ""] #[doc = $why])?
            pub const $name: Service<$message> = Service::of({
                #[allow(unused_mut, unused_assignments)]
                let mut row = Row {
                    name: $service,
                    instances: &[$service],
                    about: concat!($($about),+),
                    message: MessageType::of::<$message>(),
                    producers: $producers,
                    tools: &[],
                    consumers: $consumers,
                    wakes: $wakes,
                    delivery: $delivery,
                    taken_from: TakenFrom::$taken_from,
                    rate: $rate,
                    age_limit: AgeLimit::$age,
                    recorded: Recorded::$recorded,
                    times: Times::$times,
                    leaves: Leaves::$leaves,
                };
                $( row.instances = $instances; )?
                $( row.tools = $tools; )?
                row
            });
        )+

        /// Every row of the table.
        pub const SERVICES: &[Row] = &[$( $name.row, )+];
    };
}

use Delivery::{Latest, Queue};
use Process::{Controller, Gate, Learner, Planner, Recorder, Supervisor, World};
use Rate::{Event, Hz, Tick};

service_table! {
    /// The car's observation, at every instant of the world.
    #[comment = "The instants between two ticks wake no process."]
    OBSERVATION: Observation = "observation", Latest, from Producer,
        &[World], => &[Planner, Controller], wakes &[Planner, Controller],
        Tick(World), age Observation, recorded InStep, times Run, leaves No;

    /// The planner's answer to one observation.
    PLAN: Plan = "plan", Latest, from Producer,
        &[Planner], => &[Controller], wakes &[Controller],
        Tick(Planner), age Plan, recorded InStep, times Run, leaves No;

    /// The action for the car.
    COMMAND: Command = "command", Latest, from Producer,
        &[Controller], => &[World], wakes &[World],
        Tick(Controller), age Command, recorded InStep, times Run, leaves No;

    /// The record of one tick: everything known and decided in it.
    STEP: Step = "step", Queue(STEP_QUEUE), from Producer,
        &[Controller], => &[Gate, Learner, Supervisor], wakes &[Gate, Learner],
        Tick(Controller), age None, recorded Yes, times Run, leaves Every;

    /// Which driver should drive, and until when.
    ADVICE: Advice = "advice", Latest, from Producer,
        &[Gate], => &[Controller], wakes &[Controller],
        Tick(Controller), age OwnExpiry, recorded InStep, times Run, leaves Newest;

    /// The action of a human driver at the keys.
    #[comment = "It wakes no process: a tick takes the newest message."]
    TAKEOVER: Takeover = "takeover", Latest, from Producer,
        &[Supervisor], => &[Controller], wakes &[],
        Hz(20.0), age Takeover, recorded InStep, times Run, leaves No;

    /// A request for a picture.
    #[comment = "It wakes no process: a thread beside the world's tick polls it."]
    FRAME_REQUEST: FrameRequest = "frame_request", Latest, from Anyone,
        &[Gate], => &[World], wakes &[],
        Event("each question to a model"), age None, recorded No, times Run, leaves Newest;

    /// A picture of the scene.
    FRAME: Frame = "frame", Latest, from Producer,
        &[World], => &[Gate], wakes &[Gate],
        Event("each request"), age None, recorded Yes, times Run, leaves Newest;

    /// What would follow if either proposal were held; from a simulator, for the record alone.
    FORESIGHT: Foresight = "foresight", Latest, from Producer,
        &[World], => &[Gate], wakes &[Gate],
        Event("each request"), age None, recorded Yes, times Run, leaves Newest;

    /// A policy file offered for adoption.
    #[comment = "It wakes no process: a thread beside the controller's tick polls it."]
    WEIGHTS: Weights = "weights", Latest, from Anyone,
        &[Learner], tools &["swap"], => &[Controller], wakes &[],
        Event("each block of updates, each swap"), age None, recorded Yes, times Machine, leaves Newest;

    /// The progress of the learner.
    LEARNING: Learning = "learning", Latest, from Producer,
        &[Learner], => &[Controller], wakes &[Controller],
        Tick(Controller), age None, recorded Yes, times Machine, leaves Newest;

    /// The status of an offered policy.
    POLICY_STATUS: PolicyStatus = "policy_status", Latest, from Producer,
        &[Controller], => &[Learner, Supervisor], wakes &[Learner],
        Event("each change"), age None, recorded Yes, times Machine, leaves Newest;

    /// The progress of the episode.
    PROGRESS: Progress = "progress", Latest, from Producer,
        &[World], => &[Supervisor], wakes &[],
        Tick(Controller), age None, recorded Yes, times Run, leaves Newest;

    /// The result of an episode.
    EPISODE: Episode = "episode", Queue(EPISODE_QUEUE), from Producer,
        &[World], => &[Supervisor], wakes &[],
        Event("each end of an episode"), age None, recorded Yes, times Run, leaves Every;

    /// The health of a process.
    HEALTH: Health = "health/*" of each_process!("health"), Latest, from Producer,
        STARTED, => &[Supervisor], wakes &[],
        Hz(20.0), age None, recorded Yes, times Machine, leaves Newest;

    /// The histograms of a process's durations.
    TIMING: Timing = "timing/*" of each_process!("timing"), Latest, from Producer,
        STARTED, => &[Supervisor], wakes &[],
        Hz(2.0), age None, recorded Yes, times Machine, leaves Newest;

    /// The process ids that the run has started; a reader takes state from no other process.
    #[comment = "It wakes no process: a reader reads it when a message comes from an unknown process."]
    ROSTER: Roster = "roster", Latest, from Producer,
        &[Supervisor], => STARTED, wakes &[],
        Hz(20.0), age None, recorded Yes, times Machine, leaves No;

    /// How far the recorder has read the steps; in lockstep the controller waits for it.
    KEPT: Kept = "kept", Latest, from Producer,
        &[Recorder], => &[Controller], wakes &[Controller],
        Event("in lockstep, each turn"), age None, recorded No, times Run, leaves No;

    /// An order to fail; processes obey it only with `run.faults`.
    #[comment = "It is a queue, so that a restarted process gets no old order. It wakes no process: each polls it between two ticks."]
    FAULT: Fault = "fault", Queue(FAULT_QUEUE), from Anyone,
        &[], tools &["bench faults"], => STARTED, wakes &[],
        Event("each order"), age None, recorded Yes, times Machine, leaves No;
}

/// The health of a process.
pub const fn health(process: Process) -> Service<Health> {
    HEALTH.of_process(process)
}

/// The histograms of a process's durations.
pub const fn timing(process: Process) -> Service<Timing> {
    TIMING.of_process(process)
}

const _: () = {
    let mut k = 0;
    while k < SERVICES.len() {
        assert!(
            SERVICES[k].wakes_readers_only(),
            "a row wakes a process that does not read it"
        );
        k += 1;
    }
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_different_and_families_name_each_process() {
        let mut names: Vec<_> = SERVICES.iter().flat_map(|row| row.instances).collect();
        let count = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), count);
        for process in Process::ALL {
            assert_eq!(health(*process).name, format!("health/{process}"));
            assert_eq!(timing(*process).name, format!("timing/{process}"));
        }
    }

    /// A service that is taken from its producer alone has one; every row has a source.
    #[test]
    fn every_row_has_a_source_and_a_reader() {
        for row in SERVICES {
            let name = row.name;
            assert!(!row.consumers.is_empty(), "{name}");
            match row.taken_from {
                TakenFrom::Producer if row.instances.len() == 1 => {
                    assert_eq!(row.producers.len(), 1, "{name}");
                }
                TakenFrom::Producer => assert_eq!(row.instances.len(), Process::ALL.len()),
                TakenFrom::Anyone => {
                    assert!(row.producers.len() + row.tools.len() > 0, "{name}");
                }
            }
        }
    }
}
