//! The compiled half of the Python package `vlaps`: batches of worlds that write into
//! arrays which Python owns.
//!
//! | module | holds |
//! |---|---|
//! | `options` | what environments are like, as Python passes it |
//! | `env`, `batch` | one environment, many on several threads: plain Rust |
//! | `expert`, `drive` | experts asked in environments; whole episodes by a driver |
//! | `policy` | policy files |
//! | `single`, `worlds`, `state` | the Python classes |
//! | `calls` | what the classes share |
//!
//! Nothing here uses shared memory or a real-time process.

mod batch;
mod calls;
mod drive;
mod env;
mod expert;
mod options;
mod policy;
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
    module.add_class::<policy::PolicyFile>()?;
    module.add_function(wrap_pyfunction!(policy::encode_policy, module)?)?;
    module.add_function(wrap_pyfunction!(drive::drive_seeds, module)?)?;
    module.add_function(wrap_pyfunction!(drive::mean_interval, module)?)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    Ok(())
}
