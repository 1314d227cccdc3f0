//! Training, evaluation, sweeps and parity: the program `vlaps-lab`, to which
//! `./vlaps eval`, `train`, `sweep` and `draw` hand over.
//!
//! | module | holds |
//! |---|---|
//! | [`eval`], [`episodes`], [`evaluation`] | the command, many episodes, and their table |
//! | [`outside`] | the same in the real MetaDrive |
//! | [`train`] | the paper's experiment, its curves and tables |
//! | [`sweep`] | the cost of a judge that is wrong, silent or late |
//! | [`parity`] | the built-in world against recordings of MetaDrive |
//! | [`metric`] | keys and names of the figures |
//! | [`statistics`] | means with 95 % intervals, quantiles |
//! | [`report`] | tables, and the machine that figures are from |
//! | [`progress`], [`stop`] | a progress bar, and Ctrl-C |
//!
//! ```
//! use lab::statistics::Estimate;
//!
//! let arrived = Estimate::of_share(43, 50);
//! assert!(arrived.low > 0.7 && arrived.high < 0.95);
//! ```

pub mod episodes;
pub mod eval;
pub mod evaluation;
pub mod metric;
pub mod outside;
pub mod parity;
pub mod progress;
pub mod report;
pub mod statistics;
pub mod stop;
pub mod sweep;
pub mod train;

use eval::Eval;
use sweep::Sweep;
use train::arguments::Train;
use view::draw::Draw;

supervisor::subcommands! {
    /// The commands of this program.
    Command {
        Eval(Eval),
        Train(Train),
        Sweep(Sweep),
        /// Draw a map, an episode or a plan from above as SVG, or a camera frame as PNG.
        #[command(subcommand, arg_required_else_help = true)]
        Draw(Draw),
    }
}
