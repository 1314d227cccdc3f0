//! Policy files: reads, checks and runs them as the controller does, and writes them.

use std::sync::Mutex;

use controller::Terms;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use policy::{Activation, Layer, Mlp, Net, Provenance, decode, encode};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use shm_config::config::{Clock, Config};
use shm_config::message::FEATURES;

use crate::calls::take;
use crate::drive::clock;

/// Algorithm, seed, steps and commit of a policy.
type Origin = (String, u64, u64, String);

/// A policy file in memory. `vlaps.Policy` wraps it.
#[pyclass(frozen, module = "vlaps")]
pub struct PolicyFile {
    policy: Mutex<Box<dyn controller::Policy>>,
    sha256: String,
    origin: Option<Origin>,
    is_native: bool,
    probes: usize,
}

fn refused(refusal: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(format!("the policy is refused: {refusal}"))
}

#[pymethods]
impl PolicyFile {
    /// Makes every check that a controller makes in lockstep. `onnxruntime` is the library or
    /// its folder, for networks that need it.
    #[new]
    fn new(py: Python, bytes: &[u8], onnxruntime: &str) -> PyResult<Self> {
        py.detach(|| {
            let file = decode(bytes).map_err(refused)?;
            let mut config = Config::default();
            config.run.clock = Clock::Lockstep;
            onnxruntime.clone_into(&mut config.policy.onnxruntime);
            let terms = Terms {
                config: &config,
                version: 1,
                clock,
            };
            let policy = controller::build(bytes, &terms).map_err(refused)?;
            let hex = file.sha256.iter().map(|byte| format!("{byte:02x}"));
            Ok(Self {
                policy: Mutex::new(policy),
                sha256: hex.collect(),
                is_native: matches!(file.net, Net::Mlp { .. }),
                probes: file.probes.len(),
                origin: file.provenance.map(|origin| {
                    let Provenance {
                        algorithm,
                        seed,
                        steps,
                        commit,
                    } = origin;
                    (algorithm, seed, steps, commit)
                }),
            })
        })
    }

    /// SHA-256 of the file, 64 hexadecimal digits.
    #[getter]
    fn sha256(&self) -> &str {
        &self.sha256
    }

    /// Algorithm, seed, steps and commit; `None` for a plain ONNX file.
    #[getter]
    fn origin(&self) -> Option<Origin> {
        self.origin.clone()
    }

    /// Whether the native runtime runs it; other networks need ONNX Runtime.
    #[getter]
    fn is_native(&self) -> bool {
        self.is_native
    }

    /// Number of probes in the file.
    #[getter]
    fn probes(&self) -> usize {
        self.probes
    }

    /// The actions for observations `[count, 259]`, `[count, 2]`, clamped to [-1, 1].
    fn infer<'py>(
        &self,
        py: Python<'py>,
        observations: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let (count, features) = observations.as_array().dim();
        if features != FEATURES {
            return Err(PyValueError::new_err(format!(
                "the observation has {features} numbers: a policy takes {FEATURES}, those of the \
                 default lidar with 240 beams"
            )));
        }
        let rows = observations.as_slice()?;
        let actions = py.detach(|| -> PyResult<Vec<f32>> {
            let mut policy = take(&self.policy)?;
            let mut actions = Vec::with_capacity(2 * count);
            for (index, row) in rows.chunks_exact(FEATURES).enumerate() {
                let action = policy.infer(row).filter(|action| action.is_finite());
                let action = action.ok_or_else(|| {
                    let text = format!("observation {index}: the policy's answer is not finite");
                    PyValueError::new_err(text)
                })?;
                let action = action.clamped();
                actions.extend([action.steer as f32, action.pedal as f32]);
            }
            Ok(actions)
        })?;
        PyArray1::from_vec(py, actions).reshape([count, 2])
    }
}

/// Weights `[outputs, inputs]`, bias `[outputs]`, and activation: "", "relu" or "tanh".
type LayerArrays<'py> = (
    PyReadonlyArray2<'py, f32>,
    PyReadonlyArray1<'py, f32>,
    String,
);

fn layer((weights, bias, activation): &LayerArrays) -> PyResult<Layer> {
    let activation = match activation.as_str() {
        "" => Activation::None,
        "relu" => Activation::Relu,
        "tanh" => Activation::Tanh,
        other => {
            return Err(PyTypeError::new_err(format!(
                "activation {other:?}: choose from None, \"relu\", \"tanh\""
            )));
        }
    };
    let (outputs, inputs) = weights.as_array().dim();
    Ok(Layer {
        weights: weights.as_slice()?.to_vec(),
        bias: bias.as_slice()?.to_vec(),
        inputs,
        outputs,
        activation,
    })
}

/// Writes a policy file of these layers, with the answers to the probes `[count, 259]` and
/// its origin; returns its bytes.
#[pyfunction]
pub fn encode_policy<'py>(
    py: Python<'py>,
    layers: Vec<LayerArrays<'py>>,
    origin: Origin,
    probes: PyReadonlyArray2<'py, f32>,
) -> PyResult<Bound<'py, PyBytes>> {
    let layers: PyResult<Vec<Layer>> = layers.iter().map(layer).collect();
    let mlp = Mlp::new(layers?).map_err(refused)?;
    let (algorithm, seed, steps, commit) = origin;
    let origin = Provenance {
        algorithm,
        seed,
        steps,
        commit,
    };
    let rows = probes.as_array();
    let probes: Vec<Vec<f32>> = rows.rows().into_iter().map(|row| row.to_vec()).collect();
    Ok(PyBytes::new(py, &encode(&mlp, &origin, &probes)))
}
