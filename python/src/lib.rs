//! The compiled half of the Python package `vlaps`: batches of worlds that write into
//! arrays which Python owns.
//!
//! | module | holds |
//! |---|---|
//! | `options` | what environments are like, as Python passes it |
//! | `env`, `batch` | one environment, many on several threads: plain Rust |
//! | `single`, `worlds`, `state` | the Python classes |
//! | `calls` | what the classes share |
//!
//! Nothing here uses shared memory or a real-time process.

mod batch;
mod calls;
mod env;
mod options;
mod single;
mod state;
mod worlds;

use pyo3::prelude::*;

/// The compiled module; `vlaps` wraps it.
#[pymodule]
fn _vlaps(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<single::World>()?;
    module.add_class::<worlds::Worlds>()?;
    module.add_class::<state::State>()?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    Ok(())
}
