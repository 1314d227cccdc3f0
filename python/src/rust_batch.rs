//! Worlds that are driven without Python: what `benchmarks/speed.py` compares the Python
//! classes with.

use std::num::NonZeroUsize;
use std::sync::Mutex;

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray3};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use shm_config::message::Observation;
use sim::{AfterEnd, Batch, BatchConfig, World, WorldError};
use vehicle::Action;

use crate::calls::take;
use crate::env::{STATE_FEATURES, action};
use crate::options::Options;

/// Ticks that a world makes in a row when it is driven alone: after the first one its
/// memory is in the first cache.
const PORTION: usize = 10;

/// One world with its observation.
struct Alone {
    world: World,
    observation: Box<Observation>,
}

impl Alone {
    /// Drives for a tick, and begins the episode `stride` seeds further when one ends.
    fn step(&mut self, action: Action, stride: u64) -> Result<(), WorldError> {
        if self.world.step(action).has_ended() {
            self.world.reset(self.world.seed().wrapping_add(stride))?;
        }
        self.world.observe(&mut self.observation);
        Ok(())
    }
}

/// How the worlds are driven.
enum Way {
    Together(Batch),
    OneByOne(Vec<Alone>),
}

/// The batch of the crate `sim`, or the same worlds one by one on the caller's thread. World
/// k begins with the episode of the first seed plus k.
#[pyclass(frozen, module = "vlaps")]
pub struct RustBatch {
    way: Mutex<Way>,
    worlds: usize,
    features: usize,
    first_seed: u64,
}

impl RustBatch {
    fn drive_all(&self, way: &mut Way, actions: &[Action]) -> Result<(), WorldError> {
        let worlds = match way {
            Way::Together(batch) => {
                let mut ticks = actions.chunks_exact(self.worlds);
                return ticks.try_for_each(|tick| batch.step(tick));
            }
            Way::OneByOne(worlds) => worlds,
        };
        let stride = self.worlds as u64;
        for ticks in actions.chunks(PORTION * self.worlds) {
            for (k, alone) in worlds.iter_mut().enumerate() {
                for tick in ticks.chunks_exact(self.worlds) {
                    alone.step(tick[k], stride)?;
                }
            }
        }
        Ok(())
    }
}

fn failure(error: WorldError) -> PyErr {
    PyRuntimeError::new_err(error.to_string())
}

#[pymethods]
impl RustBatch {
    /// `threads` 0 drives the worlds one by one. The seeds are those from the options' first
    /// one on, in order.
    #[new]
    fn new(options: &str, worlds: usize, threads: usize) -> PyResult<Self> {
        let options = Options::parse(options).map_err(PyValueError::new_err)?;
        let count = NonZeroUsize::new(worlds)
            .ok_or_else(|| PyValueError::new_err("worlds = 0: it must be at least 1"))?;
        let way = match NonZeroUsize::new(threads) {
            Some(threads) => {
                let stride = worlds as u64;
                let settings = BatchConfig {
                    worlds: count,
                    threads,
                    after_end: AfterEnd::Restart { stride },
                };
                let batch = Batch::new(&options.world, settings, options.seeds.first);
                Way::Together(batch.map_err(failure)?)
            }
            None => {
                let world = World::new(options.world.clone()).map_err(failure)?;
                let alone = |_| Alone {
                    world: world.clone(),
                    observation: Box::default(),
                };
                Way::OneByOne((0..worlds).map(alone).collect())
            }
        };
        let made = Self {
            way: Mutex::new(way),
            worlds,
            features: STATE_FEATURES + options.world.scanner.beams as usize,
            first_seed: options.seeds.first,
        };
        made.reset()?;
        Ok(made)
    }

    /// Begins the first episode of each world again.
    fn reset(&self) -> PyResult<()> {
        match &mut *take(&self.way)? {
            Way::Together(batch) => batch.reset(self.first_seed).map_err(failure),
            Way::OneByOne(worlds) => {
                for (k, Alone { world, observation }) in worlds.iter_mut().enumerate() {
                    world.reset(self.first_seed + k as u64).map_err(failure)?;
                    world.observe(observation);
                }
                Ok(())
            }
        }
    }

    /// Drives all worlds; `actions` is `[ticks, worlds, 2]`, float32.
    fn drive(&self, py: Python, actions: PyReadonlyArray3<f32>) -> PyResult<()> {
        let shape = actions.as_array().dim();
        if (shape.1, shape.2) != (self.worlds, 2) {
            let text = format!(
                "actions have the shape {shape:?}: it must be (ticks, {}, 2)",
                self.worlds
            );
            return Err(PyValueError::new_err(text));
        }
        let pairs = actions.as_slice()?.as_chunks().0;
        let actions: Vec<Action> = pairs.iter().map(|&pair| action(pair)).collect();
        let mut taken = take(&self.way)?;
        let way = &mut *taken;
        py.detach(|| self.drive_all(way, &actions)).map_err(failure)
    }

    /// The features of the present observations, `[worlds, features]`.
    fn observations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let mut rows = vec![0.0; self.worlds * self.features];
        let mut write = |k: usize, observation: &Observation| {
            // A row has the length of the features.
            let _ = observation.features(&mut rows[k * self.features..][..self.features]);
        };
        match &*take(&self.way)? {
            Way::Together(batch) => batch.visit(|k, report| write(k, report.observation)),
            Way::OneByOne(worlds) => {
                for (k, alone) in worlds.iter().enumerate() {
                    write(k, &alone.observation);
                }
            }
        }
        PyArray1::from_vec(py, rows).reshape([self.worlds, self.features])
    }
}
