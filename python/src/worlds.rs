//! The Python class of a batch; every call writes NumPy arrays.

use std::num::NonZeroUsize;
use std::ops::Range;
use std::sync::Mutex;

use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2, PyReadwriteArray2,
    PyReadwriteArray3,
};
use pyo3::exceptions::{PyIndexError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::batch::{Arrays, Batch};
use crate::calls::{ASSESSMENTS, assessment, check_action, check_begun, picture, take};
use crate::env::{COUNTS, Env, FIGURES, FLAGS, Pair, REALS, Reset};
use crate::expert::{Expert, config};
use crate::options::{Autoreset, Options};
use crate::state::{State, world_error};

/// Most environments of an object: 100 GB. A number with a typing error would end the process,
/// because Rust cannot report that memory is short.
const WORLDS_MAX: usize = 1 << 20;

/// Rows of the array `flags` before [`FLAGS`]: terminated, truncated, began.
const ENDS: usize = 3;

/// NumPy arrays that every call writes. Each has several outputs, because each array that is
/// borrowed costs a call 50 ns.
struct Buffers {
    /// `[2, worlds, features]`: present and final observations.
    observations: Py<PyArray3<f32>>,
    /// `[1 + REALS, worlds]`: first the reward.
    reals: Py<PyArray2<f64>>,
    /// `[COUNTS, worlds]`.
    counts: Py<PyArray2<i64>>,
    /// `[ENDS + FLAGS, worlds]`.
    flags: Py<PyArray2<bool>>,
}

/// The arrays, borrowed for one call.
struct Written<'py> {
    observations: PyReadwriteArray3<'py, f32>,
    reals: PyReadwriteArray2<'py, f64>,
    counts: PyReadwriteArray2<'py, i64>,
    flags: PyReadwriteArray2<'py, bool>,
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
    /// [`FIGURES`] numbers per environment.
    figures: Vec<f64>,
}

fn env(batch: &mut Batch, index: usize) -> PyResult<(&Options, &mut Env)> {
    let count = batch.len();
    batch.env(index).ok_or_else(|| {
        PyIndexError::new_err(format!(
            "environment {index}: there are {count}, counted from 0"
        ))
    })
}

impl Buffers {
    fn new(py: Python, worlds: usize, features: usize) -> Self {
        Self {
            observations: PyArray3::zeros(py, [2, worlds, features], false).unbind(),
            reals: PyArray2::zeros(py, [1 + REALS.len(), worlds], false).unbind(),
            counts: PyArray2::zeros(py, [COUNTS.len(), worlds], false).unbind(),
            flags: PyArray2::zeros(py, [ENDS + FLAGS.len(), worlds], false).unbind(),
        }
    }

    /// Borrows all arrays.
    ///
    /// # Errors
    /// If another call is writing them.
    fn write<'py>(&self, py: Python<'py>) -> PyResult<Written<'py>> {
        Ok(Written {
            observations: self.observations.bind(py).try_readwrite()?,
            reals: self.reals.bind(py).try_readwrite()?,
            counts: self.counts.bind(py).try_readwrite()?,
            flags: self.flags.bind(py).try_readwrite()?,
        })
    }
}

impl Written<'_> {
    /// The arrays, with the figures of each environment in a row.
    fn arrays<'a>(&'a mut self, figures: &'a mut [f64]) -> PyResult<Arrays<'a>> {
        let worlds = figures.len() / FIGURES;
        let observations = self.observations.as_slice_mut()?;
        let (observation, final_observation) = observations.split_at_mut(observations.len() / 2);
        let (terminated, flags) = self.flags.as_slice_mut()?.split_at_mut(worlds);
        let (truncated, flags) = flags.split_at_mut(worlds);
        Ok(Arrays {
            observation,
            final_observation,
            reward: &mut self.reals.as_slice_mut()?[..worlds],
            terminated,
            truncated,
            began: &mut flags[..worlds],
            figures,
        })
    }

    /// Writes the rows of figures as columns of their types.
    fn write_figures(&mut self, figures: &[f64]) -> PyResult<()> {
        let rows: &[[f64; FIGURES]] = figures.as_chunks().0;
        let mut columns = 0..FIGURES;
        let reals = &mut self.reals.as_slice_mut()?[rows.len()..];
        fill(reals, rows, &mut columns, |real| real);
        let counts = self.counts.as_slice_mut()?;
        let (counts, seeds) = counts.split_at_mut((COUNTS.len() - 1) * rows.len());
        fill(counts, rows, &mut columns, |count| count as i64);
        // The seed is stored by its bits.
        fill(seeds, rows, &mut columns, |seed| seed.to_bits() as i64);
        let flags = &mut self.flags.as_slice_mut()?[ENDS * rows.len()..];
        fill(flags, rows, &mut columns, |flag| flag != 0.0);
        Ok(())
    }
}

/// Fills an array of some columns with the next columns of the rows.
fn fill<T>(
    array: &mut [T],
    rows: &[[f64; FIGURES]],
    columns: &mut Range<usize>,
    convert: impl Fn(f64) -> T,
) {
    for (place, column) in array.chunks_exact_mut(rows.len()).zip(columns) {
        for (number, row) in place.iter_mut().zip(rows) {
            *number = convert(row[column]);
        }
    }
}

/// One action per environment.
struct Actions<'py>(PyReadonlyArray2<'py, f32>);

impl<'py> Actions<'py> {
    /// # Errors
    /// If it is not a contiguous float32 array `[count, 2]` of finite numbers.
    fn new(actions: &Bound<'py, PyAny>, count: usize) -> PyResult<Self> {
        let wrong = || {
            let shape = actions.getattr("shape").map(|shape| shape.to_string());
            let shape = shape.unwrap_or_else(|_| "of no array".into());
            PyValueError::new_err(format!(
                "actions have the shape {shape}: it must be ({count}, 2), steering and pedal, as float32"
            ))
        };
        let array: PyReadonlyArray2<f32> = actions.extract().map_err(|_| wrong())?;
        if array.as_array().dim() != (count, 2) {
            return Err(wrong());
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
    /// Locks the environments for one call.
    ///
    /// # Errors
    /// In a forked process: the threads exist only in the parent, and a call would wait for
    /// them for ever.
    fn take(&self) -> PyResult<std::sync::MutexGuard<'_, Inner>> {
        let inner = take(&self.inner)?;
        match inner.batch.threads() == 1 || self.process == std::process::id() {
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
        if worlds.get() > WORLDS_MAX {
            return Err(PyValueError::new_err(format!(
                "num_envs = {worlds}: it must be at most {WORLDS_MAX}; each takes 100 kB of memory"
            )));
        }
        let mut parsed = Options::parse(options).map_err(PyValueError::new_err)?;
        parsed.autoreset = Autoreset::parse(autoreset).map_err(PyValueError::new_err)?;
        let experts = config(experts).map_err(PyValueError::new_err)?;
        let batch = Batch::new(parsed, experts, worlds, threads).map_err(PyValueError::new_err)?;
        Ok(Self {
            buffers: Buffers::new(py, batch.len(), batch.features()),
            inner: Mutex::new(Inner {
                figures: vec![0.0; batch.len() * FIGURES],
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

    /// Names of the rows of the arrays `reals`, `counts` and `flags`.
    #[staticmethod]
    fn figure_names() -> (Vec<&'static str>, Vec<&'static str>, Vec<&'static str>) {
        (REALS.to_vec(), COUNTS.to_vec(), FLAGS.to_vec())
    }

    /// Names of the numbers of an assessment.
    #[staticmethod]
    fn assessment_names() -> Vec<&'static str> {
        ASSESSMENTS.to_vec()
    }

    /// The output arrays, by name: `observations` `[2, worlds, features]`, the present and the
    /// final ones; `reals`, of which the reward is the first row; `counts`; `flags`, whose first
    /// rows say what is terminated, what is truncated, and what began.
    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let arrays = PyDict::new(py);
        arrays.set_item("observations", &self.buffers.observations)?;
        arrays.set_item("reals", &self.buffers.reals)?;
        arrays.set_item("counts", &self.buffers.counts)?;
        arrays.set_item("flags", &self.buffers.flags)?;
        Ok(arrays)
    }

    /// Begins episodes. `seeds` has one number per environment: a seed, -1 for the next in the
    /// order of seeds, or -2 to continue the current episode.
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
            // No episode has begun yet.
            (-2, false) | (-1, _) => Reset::Next,
            (-2, true) => Reset::Keep,
            (seed, _) => Reset::To(seed.unsigned_abs()),
        };
        let resets: Vec<Reset> = seeds.iter().map(reset).collect();
        let mut written = self.buffers.write(py)?;
        let Inner { batch, figures, .. } = &mut *inner;
        let arrays = written.arrays(figures)?;
        let begun = py.detach(|| batch.reset(&resets, arrays));
        written.write_figures(figures)?;
        begun.map_err(world_error)?;
        inner.begun = true;
        Ok(())
    }

    /// The seed of the current episode in each environment.
    fn seeds(&self) -> PyResult<Vec<u64>> {
        let mut inner = self.take()?;
        check_begun(inner.begun)?;
        let count = inner.batch.len();
        let seed = |index: usize| Ok(env(&mut inner.batch, index)?.1.history().seed);
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
        let Inner { batch, figures, .. } = &mut *inner;
        let arrays = written.arrays(figures)?;
        let stepped = py.detach(|| batch.step(pairs, arrays));
        written.write_figures(figures)?;
        stepped.map_err(world_error)
    }

    /// Whether the episode of each environment has ended, `[worlds]`; the caller of `arrays` may
    /// have written into those.
    fn ended<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<bool>>> {
        Ok(PyArray1::from_vec(py, self.take()?.batch.ended()))
    }

    /// A copy of one environment's state.
    fn get_state(&self, py: Python, index: usize) -> PyResult<State> {
        let mut inner = self.take()?;
        check_begun(inner.begun)?;
        let features = inner.batch.features();
        let (_, env) = env(&mut inner.batch, index)?;
        let written = self.buffers.write(py)?;
        let observations = written.observations.as_slice()?;
        let observation = &observations[index * features..][..features];
        Ok(State::of(env, observation, &self.options))
    }

    /// Restores a state in one environment: a `State`, or its bytes.
    fn set_state(&self, py: Python, index: usize, state: &Bound<'_, PyAny>) -> PyResult<()> {
        let mut inner = self.take()?;
        check_begun(inner.begun)?;
        let features = inner.batch.features();
        let mut written = self.buffers.write(py)?;
        let Inner { batch, figures, .. } = &mut *inner;
        let env = env(batch, index)?;
        let mut arrays = written.arrays(figures)?;
        State::restore(state, &self.options, env, arrays.row(index, features))?;
        written.write_figures(figures)
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

    /// The safety check's assessment of one proposal per environment, `[worlds, numbers]`, in
    /// the order of `assessment_names`.
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
            measured.extend(assessment(env(&mut inner.batch, index)?.1, pair));
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
        picture(py, env(&mut inner.batch, index)?.1, view, size)
    }
}
