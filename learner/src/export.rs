//! Turns a network into a policy file.

use std::io;

use policy::{Activation, Layer, Mlp, Provenance, Refusal, Windows};
use shm_config::message::WEIGHTS_BYTES_MAX;

use crate::features::{COMPRESSION, scaling};
use crate::network::{Head, Network};
use crate::replay::{Buffer, Replay};

/// Number of probes in a policy file: replay states with the network's answers.
const PROBES: usize = 4;
/// What they and the provenance may add to the size of a file: 4 times 381 numbers as text.
const PROBE_BYTES: usize = 64 << 10;

/// The network as the runtime evaluates it. It takes the plain features, so it has the
/// compression of the beams, and the linear change of the networks' input is folded into
/// the layers that see them.
///
/// # Errors
/// When a number is not finite, or the sizes are not those of a policy.
pub fn mlp(network: &Network) -> Result<Mlp, Refusal> {
    let count = network.layers().len();
    let (mut convolutions, mut layers) = (Vec::new(), Vec::new());
    // How many of the first numbers that a layer takes are plain features.
    let mut plain = network.inputs();
    for (k, layer) in network.layers().enumerate() {
        let (mut weights, mut bias) = (layer.weights.to_vec(), layer.bias.to_vec());
        if let Some(windows) = layer.windows {
            let seen = |k: usize| windows.indices.get(k).map_or(0, |index| *index as usize);
            fold((&mut weights, windows.window), &mut bias, |k| {
                Some(seen(k)).filter(|feature| *feature < plain)
            });
            plain = windows.kept.min(plain);
            convolutions.push(Windows {
                inputs: layer.inputs,
                kept: windows.kept,
                window: windows.window,
                indices: windows.indices.clone(),
                weights,
                bias,
            });
            continue;
        }
        fold((&mut weights, layer.inputs), &mut bias, |k| {
            Some(k).filter(|feature| *feature < plain)
        });
        plain = 0;
        layers.push(Layer {
            weights,
            bias,
            inputs: layer.inputs,
            outputs: layer.outputs,
            activation: match (k + 1 == count, network.head()) {
                (false, _) => Activation::Relu,
                (true, Head::Tanh) => Activation::Tanh,
                (true, Head::Linear) => Activation::None,
            },
        });
    }
    Mlp::convolved(COMPRESSION, convolutions, layers)
}

/// Folds the linear change of the features into a layer's weights, rows of so many numbers, and
/// its bias. `feature` says which feature number `k` of a row belongs to, if any. All windows
/// of a convolution see features of the same kinds at the same places, so the first tells.
fn fold(
    (weights, inputs): (&mut [f32], usize),
    bias: &mut [f32],
    feature: impl Fn(usize) -> Option<usize>,
) {
    for (row, bias) in weights.chunks_exact_mut(inputs).zip(bias) {
        for (k, weight) in row.iter_mut().enumerate() {
            if let Some((scale, shift)) = feature(k).map(scaling) {
                *bias += *weight * shift;
                *weight *= scale;
            }
        }
    }
}

/// Checks that the policy file of a network fits into a message.
///
/// # Errors
/// When it does not, or a number is not finite.
pub fn check_size(network: &Network) -> io::Result<()> {
    let file = encode(network, &Provenance::default(), &[]).map_err(io::Error::other)?;
    let bytes = file.len() + PROBE_BYTES;
    if bytes <= WEIGHTS_BYTES_MAX {
        return Ok(());
    }
    let what = format!(
        "learner.hidden and learner.filters make a policy file of {bytes} bytes; the limit is \
         {WEIGHTS_BYTES_MAX}"
    );
    Err(io::Error::new(io::ErrorKind::InvalidInput, what))
}

/// The bytes of a policy file with states of the replay as probes.
///
/// # Errors
/// As [`mlp`].
pub fn with_probes(
    network: &Network,
    provenance: &Provenance,
    replay: &Replay,
) -> Result<Vec<u8>, Refusal> {
    let buffers = Buffer::ALL.into_iter();
    let states = buffers.flat_map(|buffer| replay.iter(buffer));
    let states = states.take(PROBES);
    let probes: Vec<_> = states.map(|transition| transition.state.to_vec()).collect();
    encode(network, provenance, &probes)
}

/// The bytes of a policy file with these plain features as probes.
///
/// # Errors
/// As [`mlp`].
pub fn encode(
    network: &Network,
    provenance: &Provenance,
    probes: &[Vec<f32>],
) -> Result<Vec<u8>, Refusal> {
    Ok(policy::encode(&mlp(network)?, provenance, probes))
}
