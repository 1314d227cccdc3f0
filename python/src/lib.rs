//! The compiled module of the Python package `vlaps`: batches of worlds that write into
//! NumPy arrays.
//!
//! | module | holds |
//! |---|---|
//! | `options` | options of the environments, as Python passes them |
//! | `env`, `batch`, `crew` | one environment; many environments; their threads (plain Rust) |
//! | `expert`, `drive` | experts in environments; whole episodes by a driver |
//! | `policy` | policy files |
//! | `recording` | recordings of runs |
//! | `single`, `worlds`, `state` | the Python classes |
//! | `rust_batch` | worlds driven without Python, for the benchmark |
//! | `calls` | functions shared by the classes |
//!
//! Nothing here uses shared memory or a real-time process.

mod batch;
mod calls;
mod crew;
mod drive;
mod env;
mod expert;
mod options;
mod policy;
mod recording;
mod rust_batch;
mod single;
mod state;
mod worlds;

use pyo3::prelude::*;

/// The compiled module, which the package `vlaps` wraps.
#[pymodule]
fn _vlaps(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<single::World>()?;
    module.add_class::<worlds::Worlds>()?;
    module.add_class::<rust_batch::RustBatch>()?;
    module.add_class::<state::State>()?;
    module.add_class::<policy::PolicyFile>()?;
    module.add_function(wrap_pyfunction!(policy::encode_policy, module)?)?;
    module.add_function(wrap_pyfunction!(drive::drive_seeds, module)?)?;
    module.add_function(wrap_pyfunction!(drive::mean_interval, module)?)?;
    module.add_class::<recording::RecordingFile>()?;
    module.add_class::<recording::RecordedMessages>()?;
    module.add_function(wrap_pyfunction!(recording::observation_features, module)?)?;
    module.add_function(wrap_pyfunction!(recording::words, module)?)?;
    let error = module.py().get_type::<recording::RecordingError>();
    module.add("RecordingError", error)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    Ok(())
}
