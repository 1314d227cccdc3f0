//! The Python class of a batch: every call writes arrays that Python owns.

use std::num::NonZeroUsize;
use std::sync::Mutex;

use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2, PyReadwriteArray1,
    PyReadwriteArray2,
};
use pyo3::exceptions::{PyIndexError, PyRuntimeError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::batch::{Arrays, Batch};
use crate::calls::{ASSESSMENTS, assessment, check_action, check_begun, picture, take};
use crate::env::{COUNTS, Env, FIGURES, FLAGS, Pair, REALS, Reset};
use crate::expert::{Expert, config};
use crate::options::{Autoreset, Options};
use crate::state::{State, world_error};

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

/// Many environments in one object. `vlaps.MetaDriveVectorEnv` wraps it.
#[pyclass(frozen, module = "vlaps")]
pub struct Worlds {
    inner: Mutex<Inner>,
    buffers: Buffers,
    options: String,
    process: u32,
}

struct Inner {
    batch: Batch,
    begun: bool,
}

impl Inner {
    fn env(&mut self, index: usize) -> PyResult<(&Options, &mut Env)> {
        let count = self.batch.len();
        self.batch.env(index).ok_or_else(|| {
            PyIndexError::new_err(format!(
                "environment {index}: there are {count}, counted from 0"
            ))
        })
    }
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
            figures: PyArray2::zeros(py, [worlds, FIGURES], false).unbind(),
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

/// One action for each environment.
struct Actions<'py>(PyReadonlyArray2<'py, f32>);

impl<'py> Actions<'py> {
    /// # Errors
    /// When it is no contiguous float32 array `[count, 2]` of finite numbers.
    fn new(actions: &Bound<'py, PyAny>, count: usize) -> PyResult<Self> {
        let array: PyReadonlyArray2<f32> = actions.extract().map_err(|_| {
            PyTypeError::new_err("actions must be a float32 array of two dimensions")
        })?;
        let shape = array.as_array().dim();
        if shape != (count, 2) {
            return Err(PyValueError::new_err(format!(
                "actions have the shape {shape:?}: it must be ({count}, 2), steering and pedal"
            )));
        }
        let actions = Self(array);
        for (index, &pair) in actions.pairs()?.iter().enumerate() {
            check_action(index, pair)?;
        }
        Ok(actions)
    }

    fn pairs(&self) -> PyResult<&[Pair]> {
        Ok(self.0.as_slice()?.as_chunks().0)
    }
}

impl Worlds {
    /// Takes the environments for one call.
    ///
    /// # Errors
    /// In a process that was forked from the one that made the threads: they are not
    /// in it, and a call would wait for them for ever.
    fn take(&self) -> PyResult<std::sync::MutexGuard<'_, Inner>> {
        let inner = take(&self.inner)?;
        match self.process == std::process::id() || inner.batch.threads() == 0 {
            true => Ok(inner),
            false => Err(PyRuntimeError::new_err(
                "these environments were made before a fork and have threads that the new process \
                 lacks: make them after the fork, use the spawn method, or threads=1",
            )),
        }
    }
}

#[pymethods]
impl Worlds {
    #[new]
    fn new(
        py: Python,
        options: &str,
        experts: &str,
        autoreset: &str,
        worlds: usize,
        threads: usize,
    ) -> PyResult<Self> {
        let one = |name: &str, value: usize| {
            NonZeroUsize::new(value)
                .ok_or_else(|| PyValueError::new_err(format!("{name} = 0: it must be at least 1")))
        };
        let (worlds, threads) = (one("num_envs", worlds)?, one("threads", threads)?);
        let mut parsed = Options::parse(options).map_err(PyValueError::new_err)?;
        parsed.autoreset = Autoreset::parse(autoreset).map_err(PyValueError::new_err)?;
        let experts = config(experts).map_err(PyValueError::new_err)?;
        let batch = Batch::new(parsed, experts, worlds, threads).map_err(PyValueError::new_err)?;
        Ok(Self {
            buffers: Buffers::new(py, batch.len(), batch.features()),
            inner: Mutex::new(Inner {
                batch,
                begun: false,
            }),
            options: options.to_owned(),
            process: std::process::id(),
        })
    }

    /// Numbers in an observation.
    #[getter]
    fn features(&self) -> PyResult<usize> {
        Ok(take(&self.inner)?.batch.features())
    }

    /// Names of the columns of `figures`: real numbers, then counts, then flags.
    #[staticmethod]
    fn figure_names() -> (Vec<&'static str>, Vec<&'static str>, Vec<&'static str>) {
        (REALS.to_vec(), COUNTS.to_vec(), FLAGS.to_vec())
    }

    /// Names of the numbers of an assessment.
    #[staticmethod]
    fn assessment_names() -> Vec<&'static str> {
        ASSESSMENTS.to_vec()
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
    fn reset(&self, py: Python, seeds: Vec<i64>) -> PyResult<()> {
        let mut inner = self.take()?;
        if seeds.len() != inner.batch.len() {
            return Err(PyValueError::new_err(format!(
                "{} seeds for {} environments",
                seeds.len(),
                inner.batch.len()
            )));
        }
        let begun = inner.begun;
        let reset = |&seed: &i64| match (seed, begun) {
            // There is no running episode yet.
            (-2, false) | (-1, _) => Reset::Next,
            (-2, true) => Reset::Keep,
            (seed, _) => Reset::To(seed.unsigned_abs()),
        };
        let resets: Vec<Reset> = seeds.iter().map(reset).collect();
        let mut written = self.buffers.write(py)?;
        let arrays = written.arrays()?;
        let batch = &mut inner.batch;
        py.detach(|| batch.reset(&resets, arrays))
            .map_err(world_error)?;
        inner.begun = true;
        Ok(())
    }

    /// The seed of the episode that runs in each environment.
    fn seeds(&self) -> PyResult<Vec<u64>> {
        let mut inner = self.take()?;
        check_begun(inner.begun)?;
        let count = inner.batch.len();
        let seed = |index: usize| Ok(inner.env(index)?.1.history().seed);
        (0..count).map(seed).collect()
    }

    /// Drives every environment for one tick; `actions` is `[worlds, 2]`, steering and
    /// pedal in [-1, 1], as float32.
    fn step(&self, py: Python, actions: &Bound<'_, PyAny>) -> PyResult<()> {
        let mut inner = self.take()?;
        check_begun(inner.begun)?;
        let actions = Actions::new(actions, inner.batch.len())?;
        let pairs = actions.pairs()?;
        let mut written = self.buffers.write(py)?;
        let arrays = written.arrays()?;
        let batch = &mut inner.batch;
        py.detach(|| batch.step(pairs, arrays)).map_err(world_error)
    }

    /// A copy of one environment's state.
    fn get_state(&self, py: Python, index: usize) -> PyResult<State> {
        let mut inner = self.take()?;
        check_begun(inner.begun)?;
        let features = inner.batch.features();
        let (_, env) = inner.env(index)?;
        let mut written = self.buffers.write(py)?;
        let mut arrays = written.arrays()?;
        let row = arrays.row(index, features);
        Ok(State::of(env, row.observation, &self.options))
    }

    /// Puts one environment into a state: a `State`, or its bytes.
    fn set_state(&self, py: Python, index: usize, state: &Bound<'_, PyAny>) -> PyResult<()> {
        let mut inner = self.take()?;
        check_begun(inner.begun)?;
        let features = inner.batch.features();
        let env = inner.env(index)?;
        let mut written = self.buffers.write(py)?;
        let mut arrays = written.arrays()?;
        State::restore(state, &self.options, env, arrays.row(index, features))
    }

    /// The action of an expert in each wanted environment, `[worlds, 2]`, clamped; NaN
    /// in the others.
    fn advise<'py>(
        &self,
        py: Python<'py>,
        expert: &str,
        wanted: Vec<bool>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let mut inner = self.take()?;
        check_begun(inner.begun)?;
        let expert = Expert::parse(expert).map_err(PyValueError::new_err)?;
        let count = inner.batch.len();
        if wanted.len() != count {
            let text = format!("{} marks for {count} environments", wanted.len());
            return Err(PyValueError::new_err(text));
        }
        let batch = &mut inner.batch;
        let advice = py.detach(|| batch.advise(expert, &wanted));
        let advice = advice.map_err(PyValueError::new_err)?;
        PyArray1::from_vec(py, advice.into_flattened()).reshape([count, 2])
    }

    /// The tick's assessment of one proposal in every environment, `[worlds, numbers]`
    /// in the order of `assessment_names`.
    fn judge<'py>(
        &self,
        py: Python<'py>,
        actions: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let mut inner = self.take()?;
        check_begun(inner.begun)?;
        let count = inner.batch.len();
        let actions = Actions::new(actions, count)?;
        let mut measured = Vec::with_capacity(count * ASSESSMENTS.len());
        for (index, &pair) in actions.pairs()?.iter().enumerate() {
            measured.extend(assessment(inner.env(index)?.1, pair));
        }
        PyArray1::from_vec(py, measured).reshape([count, ASSESSMENTS.len()])
    }

    /// A picture of one environment, `[height, width, 3]`.
    fn render<'py>(
        &self,
        py: Python<'py>,
        index: usize,
        view: &str,
        size: [u32; 2],
    ) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let mut inner = self.take()?;
        check_begun(inner.begun)?;
        picture(py, inner.env(index)?.1, view, size)
    }
}
