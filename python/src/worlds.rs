//! The Python class of a batch.

use std::num::NonZeroUsize;

use numpy::{
    PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadwriteArray1, PyReadwriteArray2,
};
use pyo3::exceptions::{PyIndexError, PyRuntimeError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use serde::{Deserialize, Serialize};
use sim::WorldError;
use vehicle::Action;

use crate::batch::{Arrays, Batch, Env, FIGURES, Reset};
use crate::options::Options;

/// Raised whenever what a state holds changes its meaning.
const STATE_VERSION: u32 = 1;

/// A state of one environment that can be stored: the seed and all actions since the
/// episode began, which are the same episode, bit by bit.
#[derive(Serialize, Deserialize)]
struct Stored {
    version: u32,
    options: String,
    seed: u64,
    place: u64,
    actions: Vec<[f64; 2]>,
}

/// A state of one environment, to go back to at once.
#[pyclass(frozen, module = "vlaps")]
pub struct State {
    env: Env,
    options: String,
}

#[pymethods]
impl State {
    /// The state as bytes: the episode's seed and the actions since it began.
    fn __bytes__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let (seed, place, actions) = self.env.history();
        let stored = Stored {
            version: STATE_VERSION,
            options: self.options.clone(),
            seed,
            place,
            actions: actions
                .iter()
                .map(|action| [action.steer, action.pedal])
                .collect(),
        };
        let bytes = serde_json::to_vec(&stored)
            .map_err(|error| PyRuntimeError::new_err(error.to_string()))?;
        Ok(PyBytes::new(py, &bytes))
    }
}

/// Arrays that Python owns and every call writes.
struct Buffers {
    observation: Py<PyArray2<f32>>,
    final_observation: Py<PyArray2<f32>>,
    reward: Py<PyArray1<f64>>,
    terminated: Py<PyArray1<bool>>,
    truncated: Py<PyArray1<bool>>,
    began: Py<PyArray1<bool>>,
    figures: Py<PyArray2<f64>>,
}

/// Those arrays while a call writes them.
struct Written<'py> {
    observation: PyReadwriteArray2<'py, f32>,
    final_observation: PyReadwriteArray2<'py, f32>,
    reward: PyReadwriteArray1<'py, f64>,
    terminated: PyReadwriteArray1<'py, bool>,
    truncated: PyReadwriteArray1<'py, bool>,
    began: PyReadwriteArray1<'py, bool>,
    figures: PyReadwriteArray2<'py, f64>,
}

/// Many environments in one object. The package's environments are made of it.
#[pyclass(module = "vlaps", name = "Worlds")]
pub struct Worlds {
    batch: Batch,
    buffers: Buffers,
    actions: Vec<Action>,
    options: String,
    process: u32,
}

fn world_error(error: WorldError) -> PyErr {
    PyValueError::new_err(error.to_string())
}

impl Buffers {
    fn new(py: Python, worlds: usize, features: usize) -> Self {
        Self {
            observation: PyArray2::zeros(py, [worlds, features], false).unbind(),
            final_observation: PyArray2::zeros(py, [worlds, features], false).unbind(),
            reward: PyArray1::zeros(py, worlds, false).unbind(),
            terminated: PyArray1::zeros(py, worlds, false).unbind(),
            truncated: PyArray1::zeros(py, worlds, false).unbind(),
            began: PyArray1::zeros(py, worlds, false).unbind(),
            figures: PyArray2::zeros(py, [worlds, FIGURES.len()], false).unbind(),
        }
    }

    /// Borrows all arrays.
    ///
    /// # Errors
    /// When another call writes them at this moment.
    fn write<'py>(&self, py: Python<'py>) -> PyResult<Written<'py>> {
        Ok(Written {
            observation: self.observation.bind(py).try_readwrite()?,
            final_observation: self.final_observation.bind(py).try_readwrite()?,
            reward: self.reward.bind(py).try_readwrite()?,
            terminated: self.terminated.bind(py).try_readwrite()?,
            truncated: self.truncated.bind(py).try_readwrite()?,
            began: self.began.bind(py).try_readwrite()?,
            figures: self.figures.bind(py).try_readwrite()?,
        })
    }
}

impl Written<'_> {
    fn arrays(&mut self) -> PyResult<Arrays<'_>> {
        Ok(Arrays {
            observation: self.observation.as_slice_mut()?,
            final_observation: self.final_observation.as_slice_mut()?,
            reward: self.reward.as_slice_mut()?,
            terminated: self.terminated.as_slice_mut()?,
            truncated: self.truncated.as_slice_mut()?,
            began: self.began.as_slice_mut()?,
            figures: self.figures.as_slice_mut()?,
        })
    }
}

impl Worlds {
    /// # Errors
    /// In a process that was forked from the one that made the threads: they are not
    /// in it, and a call would wait for them for ever.
    fn check_process(&self) -> PyResult<()> {
        match self.process == std::process::id() || self.batch.threads() == 0 {
            true => Ok(()),
            false => Err(PyRuntimeError::new_err(
                "these environments were made before a fork and have threads that the new process \
                 lacks: make them after the fork, use the spawn method, or threads=1",
            )),
        }
    }

    fn env(&mut self, index: usize) -> PyResult<(&Options, &mut Env)> {
        let count = self.batch.len();
        self.batch.env(index).ok_or_else(|| {
            PyIndexError::new_err(format!(
                "environment {index}: there are {count}, counted from 0"
            ))
        })
    }
}

#[pymethods]
impl Worlds {
    #[new]
    fn new(py: Python, options: &str, worlds: usize, threads: usize) -> PyResult<Self> {
        let one = |name: &str, value: usize| {
            NonZeroUsize::new(value)
                .ok_or_else(|| PyValueError::new_err(format!("{name} = 0: it must be at least 1")))
        };
        let (worlds, threads) = (one("num_envs", worlds)?, one("threads", threads)?);
        let parsed = Options::parse(options).map_err(PyValueError::new_err)?;
        let batch = Batch::new(parsed, worlds, threads).map_err(PyValueError::new_err)?;
        Ok(Self {
            buffers: Buffers::new(py, batch.len(), batch.features()),
            actions: vec![Action::BRAKE; batch.len()],
            batch,
            options: options.to_owned(),
            process: std::process::id(),
        })
    }

    /// Number of environments.
    #[getter]
    fn count(&self) -> usize {
        self.batch.len()
    }

    /// Numbers in an observation.
    #[getter]
    fn features(&self) -> usize {
        self.batch.features()
    }

    /// Names of the columns of `figures`.
    #[staticmethod]
    fn figure_names() -> Vec<&'static str> {
        FIGURES.to_vec()
    }

    /// The arrays that every call writes, by name.
    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let arrays = PyDict::new(py);
        arrays.set_item("observation", &self.buffers.observation)?;
        arrays.set_item("final_observation", &self.buffers.final_observation)?;
        arrays.set_item("reward", &self.buffers.reward)?;
        arrays.set_item("terminated", &self.buffers.terminated)?;
        arrays.set_item("truncated", &self.buffers.truncated)?;
        arrays.set_item("began", &self.buffers.began)?;
        arrays.set_item("figures", &self.buffers.figures)?;
        Ok(arrays)
    }

    /// Begins episodes: for each environment a seed, -1 for the next in the order of
    /// seeds, or -2 to go on with the running one.
    fn reset(&mut self, py: Python, seeds: Vec<i64>) -> PyResult<()> {
        self.check_process()?;
        if seeds.len() != self.batch.len() {
            return Err(PyValueError::new_err(format!(
                "{} seeds for {} environments",
                seeds.len(),
                self.batch.len()
            )));
        }
        let resets = seeds.iter().map(|&seed| match seed {
            -1 => Ok(Reset::Next),
            -2 => Ok(Reset::Keep),
            seed => u64::try_from(seed).map(Reset::To),
        });
        let resets: Vec<Reset> = resets
            .collect::<Result<_, _>>()
            .map_err(|_| PyValueError::new_err("a seed must not be negative"))?;
        let mut written = self.buffers.write(py)?;
        let arrays = written.arrays()?;
        let batch = &mut self.batch;
        py.detach(|| batch.reset(&resets, arrays))
            .map_err(world_error)
    }

    /// Puts the order of seeds back to its beginning.
    fn rewind(&mut self) {
        self.batch.rewind();
    }

    /// Drives every environment for one tick; `actions` is `[worlds, 2]`, steering and
    /// pedal in [-1, 1], as float32.
    fn step(&mut self, py: Python, actions: &Bound<'_, PyAny>) -> PyResult<()> {
        self.check_process()?;
        let actions: PyReadonlyArray2<f32> = actions.extract().map_err(|_| {
            PyTypeError::new_err("actions must be a float32 array of two dimensions")
        })?;
        let view = actions.as_array();
        if view.dim() != (self.batch.len(), 2) {
            return Err(PyValueError::new_err(format!(
                "actions have the shape {:?}: it must be ({}, 2), steering and pedal",
                view.shape(),
                self.batch.len()
            )));
        }
        for (index, (row, action)) in view.rows().into_iter().zip(&mut self.actions).enumerate() {
            let (steer, pedal) = (f64::from(row[0]), f64::from(row[1]));
            if !(steer.is_finite() && pedal.is_finite()) {
                return Err(PyValueError::new_err(format!(
                    "action {index} is [{steer}, {pedal}]: both numbers must be finite"
                )));
            }
            *action = Action { steer, pedal };
        }
        let mut written = self.buffers.write(py)?;
        let arrays = written.arrays()?;
        let (batch, actions) = (&mut self.batch, &self.actions);
        py.detach(|| batch.step(actions, arrays))
            .map_err(world_error)
    }

    /// A copy of one environment's state.
    fn get_state(&mut self, index: usize) -> PyResult<State> {
        let options = self.options.clone();
        let (_, env) = self.env(index)?;
        Ok(State {
            env: env.clone(),
            options,
        })
    }

    /// Puts one environment into a state: a `State`, or its bytes.
    fn set_state(&mut self, index: usize, state: &Bound<'_, PyAny>) -> PyResult<()> {
        let options = self.options.clone();
        let (parsed, env) = self.env(index)?;
        let differ = || {
            PyValueError::new_err(
                "the state is of an environment with other options: make one with the same",
            )
        };
        if let Ok(state) = state.cast::<State>() {
            if state.get().options != options {
                return Err(differ());
            }
            *env = state.get().env.clone();
            return Ok(());
        }
        let bytes: &[u8] = state.extract().map_err(|_| {
            PyTypeError::new_err("a state is what get_state returned, or bytes() of it")
        })?;
        let stored: Stored = serde_json::from_slice(bytes)
            .map_err(|error| PyValueError::new_err(format!("these bytes are no state: {error}")))?;
        if stored.version != STATE_VERSION {
            return Err(PyValueError::new_err(format!(
                "a state of version {}; this build reads version {STATE_VERSION}",
                stored.version
            )));
        }
        if stored.options != options {
            return Err(differ());
        }
        if stored
            .actions
            .iter()
            .flatten()
            .any(|number| !number.is_finite())
        {
            return Err(PyValueError::new_err(
                "the state holds an action that is no number",
            ));
        }
        let actions = stored
            .actions
            .iter()
            .map(|&[steer, pedal]| Action { steer, pedal });
        let actions: Vec<Action> = actions.collect();
        env.replay(parsed, (stored.seed, stored.place), &actions)
            .map_err(world_error)
    }
}
