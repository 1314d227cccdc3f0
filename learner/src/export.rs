//! Turns a network into a policy file.

use policy::{Activation, Layer, Mlp, Provenance, Refusal};

use crate::features::{COMPRESSION, scaling};
use crate::network::{Head, Network};
use crate::replay::{Buffer, Replay};

/// Number of probes in a policy file: replay states with the network's answers.
const PROBES: usize = 4;

/// The network as the runtime evaluates it. It takes the plain features, so it has the
/// compression of the beams, and the linear change of the networks' input is folded into
/// the first layer.
///
/// # Errors
/// When a number is not finite, or the sizes are not those of a policy.
pub fn mlp(network: &Network) -> Result<Mlp, Refusal> {
    let count = network.layers().len();
    let layers = network.layers().enumerate().map(|(k, layer)| {
        let (inputs, outputs, weights, bias) = layer;
        let activation = match (k + 1 == count, network.head()) {
            (false, _) => Activation::Relu,
            (true, Head::Tanh) => Activation::Tanh,
            (true, Head::Linear) => Activation::None,
        };
        let (mut weights, mut bias) = (weights.to_vec(), bias.to_vec());
        if k == 0 {
            for (row, bias) in weights.chunks_exact_mut(inputs).zip(&mut bias) {
                for (feature, weight) in row.iter_mut().enumerate() {
                    let (scale, shift) = scaling(feature);
                    *bias += *weight * shift;
                    *weight *= scale;
                }
            }
        }
        Layer {
            weights,
            bias,
            inputs,
            outputs,
            activation,
        }
    });
    Mlp::compressed(COMPRESSION, layers.collect())
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
