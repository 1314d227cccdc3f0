//! The program `vlaps-bench`: it measures the stack and compares it with other
//! systems. `./vlaps bench` starts it.
//!
//! | module | measures |
//! |---|---|
//! | [`speed`], [`batches`], [`metadrive`], [`photography`] | ticks per second of the built-in world, alone, in batches and beside MetaDrive; rendering time of its camera images |
//! | [`planning`] | planners on recorded scenes, beside OMPL's |
//! | [`mpc`] | the model-predictive expert over long, disturbed drives |
//! | [`tracking`] | what the expert tells of bodies that move, beside the truth |
//! | [`inference`] | inference time of a policy, by back end |
//! | [`actors`] | transitions per second from actors to their learner |
//! | [`learning`] | gradient steps per second, beside PyTorch |
//! | [`swapping`] | a running set whose weights are swapped |
//! | [`judging`] | accuracy of a judge on scenes whose answer the simulator knows |
//! | [`latency`] | punctuality of a running set under load |
//! | [`ipc`] | message latency beside bare iceoryx2, Cyclone DDS and Zenoh |
//! | [`replaying`] | replays and forks of recordings |
//! | [`faults`] | running sets under injected faults |
//! | [`scale`] | how each cost grows with its work; a fleet from measured costs |
//! | [`soak`] | memory growth of a set over millions of ticks |
//!
//! | module | shared by them |
//! |---|---|
//! | [`driven`] | a whole process set, driven for a measurement |
//! | [`floor`] | wake-up lateness of an idle thread on this machine |
//! | [`stalls`] | stalls of the machine, measured on each core |
//! | [`gauges`] | time, processor time, memory |
//!
//! ```
//! use bench::stalls::Stalls;
//! use shm_config::Instant;
//!
//! // A wake-up that was due at 1 s came 30 ms late.
//! let mut stalls = Stalls::from(Instant(0));
//! stalls.note(Instant(1_000_000_000), 30_000_000);
//! let tick = Instant(1_050_000_000);
//! assert_eq!(stalls.near(tick, 100_000_000), 30_000_000);
//! ```

pub mod actors;
pub mod batches;
pub mod driven;
pub mod faults;
pub mod floor;
pub mod gauges;
pub mod inference;
pub mod ipc;
pub mod judging;
pub mod latency;
pub mod learning;
pub mod metadrive;
pub mod mpc;
pub mod photography;
pub mod planning;
mod products;
pub mod replaying;
mod rows;
pub mod scale;
pub mod soak;
pub mod speed;
pub mod stalls;
pub mod swapping;
pub mod tracking;

supervisor::subcommands! {
    /// What to measure.
    Bench {
        Parity(lab::parity::Parity),
        Sim(speed::Sim),
        Planner(planning::BenchPlanner),
        Mpc(mpc::BenchMpc),
        Tracker(tracking::BenchTracker),
        Policy(inference::BenchPolicy),
        Learner(learning::BenchLearner),
        Actors(actors::BenchActors),
        Swap(swapping::BenchSwap),
        Judge(judging::BenchJudge),
        Latency(latency::BenchLatency),
        Ipc(ipc::BenchIpc),
        #[command(hide = true)]
        IpcEcho(ipc::IpcEcho),
        Replay(replaying::BenchReplay),
        Faults(faults::BenchFaults),
        Scale(scale::BenchScale),
        Soak(soak::BenchSoak),
    }
}

supervisor::subcommands! {
    /// The commands of this program.
    Command {
        /// Measure, and compare with other systems.
        #[command(subcommand, arg_required_else_help = true)]
        Bench(Bench),
    }
}
