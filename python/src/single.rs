//! The Python class of one environment; every call returns new objects.

use std::num::NonZeroUsize;
use std::sync::Mutex;

use numpy::{PyArray1, PyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};

use crate::batch::Batch;
use crate::calls::{ASSESSMENTS, assessment, check_action, check_begun, picture, take};
use crate::env::{COUNTS, Env, FIGURES, FLAGS, Pair, REALS, Reset, Row};
use crate::expert::{Expert, config};
use crate::options::Options;
use crate::state::{State, world_error};

/// The output of one call.
struct Outcome {
    observation: Vec<f32>,
    reward: f64,
    terminated: bool,
    truncated: bool,
    began: bool,
    figures: [f64; FIGURES],
}

impl Outcome {
    fn row(&mut self) -> Row<'_> {
        Row {
            observation: &mut self.observation,
            // Only a batch begins the next episode within a call.
            final_observation: &mut [],
            reward: &mut self.reward,
            terminated: &mut self.terminated,
            truncated: &mut self.truncated,
            began: &mut self.began,
            figures: &mut self.figures,
        }
    }
}

struct Inner {
    batch: Batch,
    outcome: Outcome,
    begun: bool,
}

impl Inner {
    /// The environment with its options and its row.
    fn parts(&mut self) -> PyResult<(&Options, &mut Env, Row<'_>)> {
        let env = self.batch.env(0);
        let (options, env) = env.ok_or_else(|| PyValueError::new_err("no environment"))?;
        Ok((options, env, self.outcome.row()))
    }
}

/// One environment. `vlaps.MetaDriveEnv` wraps it.
#[pyclass(frozen, module = "vlaps")]
pub struct World {
    inner: Mutex<Inner>,
    names: Vec<Py<PyString>>,
    options: String,
}

/// Observation, reward, terminated, truncated, info.
type Stepped<'py> = (
    Bound<'py, PyArray1<f32>>,
    f64,
    bool,
    bool,
    Bound<'py, PyDict>,
);

impl World {
    fn info<'py>(&self, py: Python<'py>, figures: &[f64]) -> PyResult<Bound<'py, PyDict>> {
        let info = PyDict::new(py);
        let (reals, others) = figures.split_at(REALS.len());
        let (counts, flags) = others.split_at(COUNTS.len());
        let mut names = self.names.iter();
        for (&real, name) in reals.iter().zip(names.by_ref()) {
            info.set_item(name, real)?;
        }
        for ((&count, of), name) in counts.iter().zip(COUNTS).zip(names.by_ref()) {
            let is_seed = of == "seed";
            info.set_item(
                name,
                if is_seed {
                    count.to_bits()
                } else {
                    count as u64
                },
            )?;
        }
        for (&flag, name) in flags.iter().zip(names) {
            info.set_item(name, flag != 0.0)?;
        }
        Ok(info)
    }
}

#[pymethods]
impl World {
    #[new]
    fn new(py: Python, options: &str, experts: &str) -> PyResult<Self> {
        let parsed = Options::parse(options).map_err(PyValueError::new_err)?;
        let one = NonZeroUsize::MIN;
        let experts = config(experts).map_err(PyValueError::new_err)?;
        let batch = Batch::new(parsed, experts, one, one).map_err(PyValueError::new_err)?;
        let names = REALS.iter().chain(&COUNTS).chain(&FLAGS);
        Ok(Self {
            names: names
                .map(|name| PyString::intern(py, name).unbind())
                .collect(),
            inner: Mutex::new(Inner {
                outcome: Outcome {
                    observation: vec![0.0; batch.features()],
                    reward: 0.0,
                    terminated: false,
                    truncated: false,
                    began: false,
                    figures: [0.0; FIGURES],
                },
                batch,
                begun: false,
            }),
            options: options.to_owned(),
        })
    }

    /// Numbers in an observation.
    #[getter]
    fn features(&self) -> PyResult<usize> {
        Ok(take(&self.inner)?.batch.features())
    }

    /// Begins the episode of a seed, or the next one in the order of seeds; returns the
    /// observation and the info.
    #[pyo3(signature = (seed=None))]
    fn reset<'py>(
        &self,
        py: Python<'py>,
        seed: Option<u64>,
    ) -> PyResult<(Bound<'py, PyArray1<f32>>, Bound<'py, PyDict>)> {
        let mut inner = take(&self.inner)?;
        let reset = seed.map_or(Reset::Next, Reset::To);
        let (options, env, row) = inner.parts()?;
        py.detach(|| env.reset(options, reset, 1, row))
            .map_err(world_error)?;
        inner.begun = true;
        let observation = PyArray1::from_slice(py, &inner.outcome.observation);
        Ok((observation, self.info(py, &inner.outcome.figures)?))
    }

    /// Drives for one tick; returns observation, reward, terminated, truncated, info.
    fn step<'py>(&self, py: Python<'py>, steer: f32, pedal: f32) -> PyResult<Stepped<'py>> {
        let mut inner = take(&self.inner)?;
        check_begun(inner.begun && !inner.outcome.terminated && !inner.outcome.truncated)?;
        check_action(0, [steer, pedal])?;
        let (options, env, row) = inner.parts()?;
        py.detach(|| env.step(options, [steer, pedal], 1, row))
            .map_err(world_error)?;
        let outcome = &inner.outcome;
        Ok((
            PyArray1::from_slice(py, &outcome.observation),
            outcome.reward,
            outcome.terminated,
            outcome.truncated,
            self.info(py, &outcome.figures)?,
        ))
    }

    /// A copy of the state.
    fn get_state(&self) -> PyResult<State> {
        let mut inner = take(&self.inner)?;
        check_begun(inner.begun)?;
        let (_, env, row) = inner.parts()?;
        Ok(State::of(env, row.observation, &self.options))
    }

    /// Restores a state and returns its observation.
    fn set_state<'py>(
        &self,
        py: Python<'py>,
        state: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let mut inner = take(&self.inner)?;
        let (options, env, row) = inner.parts()?;
        State::restore(state, &self.options, (options, env), row)?;
        inner.begun = true;
        Ok(PyArray1::from_slice(py, &inner.outcome.observation))
    }

    /// The action of an expert, clamped.
    fn advise(&self, py: Python, expert: &str) -> PyResult<Pair> {
        let mut inner = take(&self.inner)?;
        check_begun(inner.begun)?;
        let expert = Expert::parse(expert).map_err(PyValueError::new_err)?;
        let batch = &mut inner.batch;
        let advice = py.detach(|| batch.advise(expert, &[true]));
        let advice = advice.map_err(PyValueError::new_err)?;
        let first = advice.first();
        first
            .copied()
            .ok_or_else(|| PyValueError::new_err("no environment"))
    }

    /// The safety check's assessment of a proposal, in the order of `assessment_names`.
    fn judge(&self, steer: f32, pedal: f32) -> PyResult<[f64; ASSESSMENTS.len()]> {
        let mut inner = take(&self.inner)?;
        check_begun(inner.begun)?;
        check_action(0, [steer, pedal])?;
        Ok(assessment(inner.parts()?.1, [steer, pedal]))
    }

    /// A picture, `[height, width, 3]`.
    fn render<'py>(
        &self,
        py: Python<'py>,
        view: &str,
        size: [u32; 2],
    ) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let mut inner = take(&self.inner)?;
        check_begun(inner.begun)?;
        picture(py, inner.parts()?.1, view, size)
    }
}
