//! Measurements, and comparisons with other systems: the program `vlaps-bench`, to
//! which `./vlaps bench` hands over.
//!
//! | module | measures |
//! |---|---|
//! | [`speed`], [`metadrive`], [`photography`] | ticks per second of the built-in world, beside MetaDrive; cost of its frames |
//! | [`planning`] | planners on recorded scenes, beside OMPL's |
//! | [`mpc`] | the model-predictive expert, disturbed for long |
//! | [`inference`] | time of a policy's answer, by back end |
//! | [`learning`] | gradient steps per second, beside PyTorch |
//! | [`swapping`] | a running set whose weights are swapped |
//! | [`judging`] | share of right answers of a judge where the simulator knows |
//! | [`latency`] | punctuality of the set under load |
//! | [`ipc`] | the wire beside bare iceoryx2, Cyclone DDS and Zenoh |
//! | [`faults`] | live sets under faults |
//! | [`soak`] | growth of a set over millions of ticks |
//!
//! | module | shared by them |
//! |---|---|
//! | [`driven`] | a whole process set, driven for a measurement |
//! | [`floor`] | lateness of a thread on this machine that does nothing else |
//! | [`stalls`] | instants at which the machine stood still, core by core |
//! | [`gauges`] | time, processor time, memory |

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
pub mod soak;
pub mod speed;
pub mod stalls;
pub mod swapping;

supervisor::subcommands! {
    /// What to measure.
    Bench {
        Parity(lab::parity::Parity),
        Sim(speed::Sim),
        Planner(planning::BenchPlanner),
        Mpc(mpc::BenchMpc),
        Policy(inference::BenchPolicy),
        Learner(learning::BenchLearner),
        Swap(swapping::BenchSwap),
        Judge(judging::BenchJudge),
        Latency(latency::BenchLatency),
        Ipc(ipc::BenchIpc),
        #[command(hide = true)]
        IpcEcho(ipc::IpcEcho),
        Faults(faults::BenchFaults),
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
