//! Functions shared by the Python classes: argument checks, pictures, assessments.

use std::sync::{Mutex, MutexGuard, TryLockError};

use numpy::{PyArray1, PyArray3, PyArrayMethods};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use shm_config::message::View;
use sim::render::Shot;

use crate::env::{Env, Pair};

/// Maximum width and height of a picture, pixels.
const SIDE_MAX_PX: u32 = 8192;

/// Names of the numbers of [`assessment`], in order.
pub const ASSESSMENTS: [&str; 6] = [
    "clearance_m",
    "safe_s",
    "edge_m",
    "progress_m",
    "verdict",
    "veto",
];

/// Locks the environments for one call.
///
/// # Errors
/// If another thread's call is running.
pub fn take<T>(inner: &Mutex<T>) -> PyResult<MutexGuard<'_, T>> {
    match inner.try_lock() {
        Ok(inner) => Ok(inner),
        // Rows are written completely or not at all, so a panic leaves no partial row.
        Err(TryLockError::Poisoned(poisoned)) => Ok(poisoned.into_inner()),
        Err(TryLockError::WouldBlock) => Err(PyRuntimeError::new_err(
            "two threads called the same environments at once: give each thread its own, and \
             call recv before anything else after send",
        )),
    }
}

/// # Errors
/// If no episode has begun.
pub fn check_begun(begun: bool) -> PyResult<()> {
    match begun {
        true => Ok(()),
        false => Err(PyRuntimeError::new_err("no episode runs: call reset first")),
    }
}

/// # Errors
/// If a number is not finite.
pub fn check_action(index: usize, [steer, pedal]: Pair) -> PyResult<()> {
    match steer.is_finite() && pedal.is_finite() {
        true => Ok(()),
        false => Err(PyValueError::new_err(format!(
            "action {index} is [{steer}, {pedal}]: both numbers must be finite"
        ))),
    }
}

/// The safety check's assessment of a proposal, as numbers.
pub fn assessment(env: &Env, proposal: Pair) -> [f64; ASSESSMENTS.len()] {
    let measured = env.judge(proposal);
    [
        measured.clearance_m,
        measured.safe_s,
        measured.edge_m,
        measured.progress_m,
        f64::from(measured.verdict),
        f64::from(measured.veto),
    ]
}

/// A picture of an environment, `[height, width, 3]`.
///
/// # Errors
/// If the view is unknown or the size out of range.
pub fn picture<'py>(
    py: Python<'py>,
    env: &Env,
    view: &str,
    [width, height]: [u32; 2],
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let view = match view {
        "top_down" => View::TopDown,
        "ego" => View::Ego,
        _ => {
            return Err(PyValueError::new_err(format!(
                "render_view {view:?}: choose from \"top_down\", \"ego\""
            )));
        }
    };
    let range = 1..=SIDE_MAX_PX;
    if !(range.contains(&width) && range.contains(&height)) {
        return Err(PyValueError::new_err(format!(
            "render_size ({width}, {height}): each must be between 1 and {SIDE_MAX_PX} pixels"
        )));
    }
    let shot = Shot {
        view,
        size_px: [width, height],
        passed: 0.0,
    };
    let rgb = py
        .detach(|| env.draw(&shot))
        .ok_or_else(|| PyRuntimeError::new_err("no memory for the picture"))?;
    PyArray1::from_vec(py, rgb).reshape([height as usize, width as usize, 3])
}
