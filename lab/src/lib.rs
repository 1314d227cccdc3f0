//! The program `vlaps-lab`: training, evaluation, sweeps, parity and recorded runs.
//! `./vlaps eval`, `train`, `relearn`, `sweep`, `replay`, `fork`, `regress`, `export` and `draw` start it.
//!
//! | module | holds |
//! |---|---|
//! | [`eval`], [`episodes`], [`evaluation`] | `./vlaps eval`, many episodes, and their table |
//! | [`outcomes`] | how episodes ended, map by map: two drivers compared, intervals over maps |
//! | [`outside`] | evaluation in simulators with a process of their own |
//! | [`train`] | the paper's experiment, its curves and tables |
//! | [`relearn`] | policies trained anew on what trainings recorded |
//! | [`actors`] | trainings whose worlds are in other processes, here or elsewhere |
//! | [`sweep`] | trainings under a judge with label noise, abstention or delay |
//! | [`parity`] | comparison of the built-in world with recordings of MetaDrive |
//! | [`replay`] | a recorded run, recomputed and compared bit by bit |
//! | [`fork`] | a recorded run, driven on from a tick |
//! | [`regress`] | the events of many recordings, driven again by another policy |
//! | [`export`] | a recording as an animation, tables or a dataset |
//! | [`shard`] | work in parts: `--shard I/N`, and their merge |
//! | [`metric`] | keys and names of the figures |
//! | [`statistics`] | means with 95 % confidence intervals, quantiles |
//! | [`report`] | tables, and the description of the machine |
//! | [`progress`], [`stop`] | progress bar, and stop requests (Ctrl-C) |
//!
//! ```
//! use lab::statistics::Estimate;
//!
//! let arrived = Estimate::of_share(43, 50);
//! assert!(arrived.low > 0.7 && arrived.high < 0.95);
//! ```

pub mod actors;
pub mod episodes;
pub mod eval;
pub mod evaluation;
pub mod export;
pub mod fork;
pub mod metric;
pub mod outcomes;
pub mod outside;
pub mod parity;
pub mod progress;
pub mod regress;
pub mod relearn;
pub mod replay;
pub mod report;
mod sections;
pub mod shard;
pub mod statistics;
pub mod stop;
pub mod sweep;
pub mod train;

use actors::arguments::Actor;
use eval::Eval;
use export::Export;
use fork::Fork;
use regress::Regress;
use relearn::Relearn;
use replay::command::Replay;
use sweep::Sweep;
use train::arguments::Train;
use view::draw::Draw;

supervisor::subcommands! {
    /// The commands of this program.
    Command {
        Eval(Eval),
        Train(Train),
        Relearn(Relearn),
        Actor(Actor),
        Sweep(Sweep),
        Replay(Replay),
        Fork(Fork),
        Regress(Regress),
        Export(Export),
        /// Draw a map, an episode or a plan from above as SVG, or a camera frame as PNG.
        #[command(subcommand, arg_required_else_help = true)]
        Draw(Draw),
    }
}
