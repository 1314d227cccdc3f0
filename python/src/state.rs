//! States of an environment: copies in memory, and bytes that can be stored.

use pyo3::exceptions::{PyRuntimeError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde::{Deserialize, Serialize};
use sim::WorldError;

use crate::env::{Env, History, Pair, Row};
use crate::options::{Options, SEEDS_END};

/// Version of the stored state; raise it whenever the meaning of a field changes.
const STATE_VERSION: u32 = 1;

/// A stored state: the seed and all actions since the episode began, which reproduce the
/// episode bit by bit.
#[derive(Serialize, Deserialize)]
struct Stored {
    version: u32,
    options: String,
    seed: u64,
    place: u64,
    is_fresh: bool,
    actions: Vec<Pair>,
    advised: Vec<u64>,
}

/// A state of one environment. `bytes()` of it can be stored.
#[pyclass(frozen, module = "vlaps")]
pub struct State {
    env: Env,
    observation: Vec<f32>,
    options: String,
}

#[pymethods]
impl State {
    /// The state as bytes: the episode's seed and the actions since it began.
    fn __bytes__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let history = self.env.history();
        let stored = Stored {
            version: STATE_VERSION,
            options: self.options.clone(),
            seed: history.seed,
            place: history.place,
            is_fresh: history.is_fresh,
            actions: history.actions.to_vec(),
            advised: history.advised.to_vec(),
        };
        let bytes = serde_json::to_vec(&stored)
            .map_err(|error| PyRuntimeError::new_err(error.to_string()))?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// A pickled state is its bytes, which `set_state` takes, too.
    fn __reduce__<'py>(
        slf: &Bound<'py, Self>,
    ) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        let py = slf.py();
        let bytes = slf.get().__bytes__(py)?;
        Ok((py.get_type::<PyBytes>().into_any(), (bytes,)))
    }

    /// A state never changes.
    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// A state never changes.
    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }
}

/// The Python exception for an episode that cannot begin.
pub fn world_error(error: WorldError) -> PyErr {
    PyValueError::new_err(error.to_string())
}

impl State {
    /// Copies an environment with its observation.
    pub fn of(env: &Env, observation: &[f32], options: &str) -> State {
        State {
            env: env.clone(),
            observation: observation.to_vec(),
            options: options.to_owned(),
        }
    }

    /// Restores a state, a [`State`] or its bytes, in an environment and writes its row.
    ///
    /// # Errors
    /// If it is not a state, or one of other options or of another version.
    pub fn restore(
        state: &Bound<'_, PyAny>,
        text: &str,
        (options, env): (&Options, &mut Env),
        mut row: Row,
    ) -> PyResult<()> {
        if let Ok(state) = state.cast::<State>() {
            let state = state.get();
            check_options(&state.options, text)?;
            env.copy_from(&state.env);
            row.observation.copy_from_slice(&state.observation);
            env.rest(options, &mut row);
            return Ok(());
        }
        let bytes: &[u8] = state.extract().map_err(|_| {
            PyTypeError::new_err("a state is what get_state returned, or bytes() of it")
        })?;
        let stored = read(bytes)?;
        check_options(&stored.options, text)?;
        let history = History {
            seed: stored.seed,
            place: stored.place,
            is_fresh: stored.is_fresh,
            actions: &stored.actions,
            advised: &stored.advised,
        };
        env.replay(options, &history, row)
            .map_err(PyValueError::new_err)
    }
}

fn check_options(of_state: &str, own: &str) -> PyResult<()> {
    match of_state == own {
        true => Ok(()),
        false => Err(PyValueError::new_err(
            "the state is of an environment with other options: make one with the same",
        )),
    }
}

fn read(bytes: &[u8]) -> PyResult<Stored> {
    let refused = |error: serde_json::Error| {
        PyValueError::new_err(format!("these bytes are no state: {error}"))
    };
    let value: serde_json::Value = serde_json::from_slice(bytes).map_err(refused)?;
    let version = value.get("version").and_then(serde_json::Value::as_u64);
    match version {
        Some(version) if version != u64::from(STATE_VERSION) => {
            return Err(PyValueError::new_err(format!(
                "a state of version {version}: this build reads version {STATE_VERSION}"
            )));
        }
        _ => {}
    }
    let stored: Stored = serde_json::from_value(value).map_err(refused)?;
    let mut numbers = stored.actions.iter().flatten();
    let wrong = if stored.seed >= SEEDS_END {
        "a seed that is not below 2**63"
    } else if !numbers.all(|number| number.is_finite()) {
        "an action that is no finite number"
    } else if !stored.advised.is_sorted()
        || stored.advised.last() > Some(&(stored.actions.len() as u64))
    {
        "questions to the expert after its last action, or in no order"
    } else {
        return Ok(stored);
    };
    Err(PyValueError::new_err(format!("the state holds {wrong}")))
}
