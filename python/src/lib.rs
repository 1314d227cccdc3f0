//! The compiled half of the Python package `vlaps`: batches of worlds that write into
//! arrays which Python owns.
//!
//! [`batch`] is plain Rust; [`worlds`] is its Python class. Nothing here uses shared
//! memory or a real-time process.

mod batch;
mod options;
mod worlds;

use pyo3::prelude::*;

/// The compiled module; `vlaps` wraps it.
#[pymodule]
fn _vlaps(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<worlds::Worlds>()?;
    module.add_class::<worlds::State>()?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    Ok(())
}
