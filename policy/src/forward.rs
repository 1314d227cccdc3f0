//! The forward pass of a net: weights and workspace are the caller's, so it needs
//! neither the standard library nor an allocator.

use shm_config::message::{FEATURES, INPUTS_WITH_MOTION};
#[cfg(not(feature = "std"))]
use vehicle::Float as _;

/// Numbers that the policy answers with: steering and pedal, normalised.
pub const ACTIONS: usize = 2;
/// Most layers of a net.
pub const LAYERS_MAX: usize = 16;
/// How many numbers a net takes whose first layer takes so many: [`INPUTS_WITH_MOTION`], or
/// [`FEATURES`].
pub const fn policy_inputs(inputs: usize) -> usize {
    match inputs {
        INPUTS_WITH_MOTION => INPUTS_WITH_MOTION,
        _ => FEATURES,
    }
}

/// Outputs whose sums are kept in registers together: four registers of AVX-512,
/// eight of AVX2, and sixteen of SSE2, half of which then live in the cache.
pub const BLOCK: usize = 64;

/// What follows a layer's sums.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Activation {
    /// Nothing.
    None,
    /// `max(0, x)`.
    Relu,
    /// `tanh(x)`.
    Tanh,
}

/// What features go through before the first layer: from feature `from` up to `to`, `x`
/// becomes `x / (1 + slope x)`. A scan's beams then differ most where something is near. The slope
/// 0 changes nothing, and costs nothing. One addition, one product and one quotient, so the
/// bits are the same on every processor.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Compression {
    /// The first feature that is compressed.
    pub from: usize,
    /// The first behind them that is not.
    pub to: usize,
    /// At least 0, finite.
    pub slope: f32,
}

impl Compression {
    /// Compresses features, in place.
    pub fn apply(self, features: &mut [f32]) {
        // Infinity times 0 would be NaN.
        if self.slope == 0.0 {
            return;
        }
        for x in features.iter_mut().take(self.to).skip(self.from) {
            *x /= 1.0 + self.slope * *x;
        }
    }
}

/// A layer, `y = activation(weights x + bias)`, as the inner loop reads it: blocks of
/// [`BLOCK`] outputs, in each first the bias, then for each input the weights of the
/// block's outputs; with zeros behind the last output.
#[derive(Debug, Clone)]
pub struct PackedLayer<B> {
    blocks: B,
    inputs: usize,
    outputs: usize,
    activation: Activation,
}

/// Layers and workspace do not make a net.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Mismatch {
    /// Weights, bias or blocks are more or fewer than inputs and outputs ask for.
    #[error("the layer has weights, bias or blocks of another size than its inputs and outputs")]
    Layer,
    /// No layer, or more than [`LAYERS_MAX`].
    #[error("the net has no layer or more than {LAYERS_MAX}")]
    Count,
    /// A layer takes another number of inputs than the one before it gives; the first
    /// takes [`FEATURES`] or [`INPUTS_WITH_MOTION`], the last gives [`ACTIONS`].
    #[error("layer {0} takes or gives another number of values than its neighbour")]
    Chain(usize),
    /// A row of the workspace is shorter than [`PackedLayer::row`] of a layer.
    #[error("the workspace is shorter than the widest layer")]
    Workspace,
}

impl<B> PackedLayer<B> {
    /// Blocks of a layer with so many inputs and outputs.
    pub const fn block_count(inputs: usize, outputs: usize) -> usize {
        outputs.div_ceil(BLOCK) * (1 + inputs)
    }

    /// Length of a workspace row that holds its input and its padded output.
    pub fn row(&self) -> usize {
        self.padded().max(self.inputs)
    }

    /// Outputs with the zeros behind them.
    pub(crate) fn padded(&self) -> usize {
        self.outputs.div_ceil(BLOCK) * BLOCK
    }
}

impl<B: AsRef<[[f32; BLOCK]]>> PackedLayer<B> {
    /// Of blocks that are packed already, such as those in read-only memory.
    ///
    /// # Errors
    /// [`Mismatch::Layer`] when there are not [`PackedLayer::block_count`] blocks.
    pub fn packed(
        blocks: B,
        [inputs, outputs]: [usize; 2],
        activation: Activation,
    ) -> Result<Self, Mismatch> {
        match blocks.as_ref().len() == Self::block_count(inputs, outputs) {
            true => Ok(Self {
                blocks,
                inputs,
                outputs,
                activation,
            }),
            false => Err(Mismatch::Layer),
        }
    }
}

/// Writes weights (`outputs` x `inputs`, row-major) and bias (`outputs`) into the blocks
/// of a [`PackedLayer`], all of them.
///
/// # Errors
/// [`Mismatch::Layer`] when the lengths do not fit each other.
pub fn pack(weights: &[f32], bias: &[f32], blocks: &mut [[f32; BLOCK]]) -> Result<(), Mismatch> {
    let outputs = bias.len();
    let inputs = weights.len().checked_div(outputs).unwrap_or(0);
    let count = PackedLayer::<()>::block_count(inputs, outputs);
    if weights.len() != inputs * outputs || blocks.len() != count || outputs == 0 {
        return Err(Mismatch::Layer);
    }
    blocks.fill([0.0; BLOCK]);
    for output in 0..outputs {
        let (block, lane) = (output / BLOCK, output % BLOCK);
        let block = &mut blocks[block * (1 + inputs)..][..1 + inputs];
        block[0][lane] = bias[output];
        let row = &weights[output * inputs..][..inputs];
        for (place, &weight) in block[1..].iter_mut().zip(row) {
            place[lane] = weight;
        }
    }
    Ok(())
}

/// A net over layers and a workspace of the caller's.
///
/// ```
/// use policy::{Activation, Net, PackedLayer, Forward, pack};
/// use shm_config::message::FEATURES;
///
/// // One layer: full pedal for any input.
/// let mut blocks = [[0.0; 64]; 1 + FEATURES];
/// pack(&[0.0; 2 * FEATURES], &[0.0, 1.0], &mut blocks)?;
/// let layers = [PackedLayer::packed(&blocks, [FEATURES, 2], Activation::Tanh)?];
/// let (mut x, mut y) = ([0.0; FEATURES], [0.0; FEATURES]);
/// let mut net = Forward::new(&layers, [&mut x, &mut y])?;
/// assert_eq!(net.infer(&[0.5; FEATURES]), [0.0, 1f32.tanh()]);
/// # Ok::<(), policy::Mismatch>(())
/// ```
#[derive(Debug)]
pub struct Forward<'a, B> {
    layers: &'a [PackedLayer<B>],
    compression: Compression,
    workspace: [&'a mut [f32]; 2],
    arch: pulp::Arch,
}

impl<'a, B: AsRef<[[f32; BLOCK]]>> Forward<'a, B> {
    /// Checks that the layers follow on each other, from the inputs of a policy
    /// (259, or 379 with how bodies move) to [`ACTIONS`], and that both rows of the
    /// workspace hold the widest of them.
    ///
    /// # Errors
    /// What does not fit.
    pub fn new(
        layers: &'a [PackedLayer<B>],
        workspace: [&'a mut [f32]; 2],
    ) -> Result<Self, Mismatch> {
        if layers.is_empty() || layers.len() > LAYERS_MAX {
            return Err(Mismatch::Count);
        }
        let mut width = policy_inputs(layers[0].inputs);
        for (k, layer) in layers.iter().enumerate() {
            if layer.inputs != width {
                return Err(Mismatch::Chain(k));
            }
            if workspace.iter().any(|row| row.len() < layer.row()) {
                return Err(Mismatch::Workspace);
            }
            width = layer.outputs;
        }
        match width {
            ACTIONS => Ok(Self {
                layers,
                compression: Compression::default(),
                workspace,
                arch: pulp::Arch::new(),
            }),
            _ => Err(Mismatch::Chain(layers.len() - 1)),
        }
    }

    /// The net behind this compression of its features.
    #[must_use]
    pub fn compressed(self, compression: Compression) -> Self {
        Self {
            compression,
            ..self
        }
    }

    /// The answer to the features: steering and pedal, normalised, as the
    /// net has them: neither clamped nor checked. Missing features count as 0,
    /// more are ignored.
    pub fn infer(&mut self, features: &[f32]) -> [f32; ACTIONS] {
        let [x, y] = &mut self.workspace;
        match *forward(self.layers, [x, y], (features, self.compression), self.arch) {
            [steer, pedal, ..] => [steer, pedal],
            // `new` has checked that there are two.
            _ => [f32::NAN; ACTIONS],
        }
    }
}

/// The forward pass: the outputs of the last layer. The layers follow on each other, and
/// both rows of the workspace hold the widest of them.
pub(crate) fn forward<'a, B: AsRef<[[f32; BLOCK]]>>(
    layers: &[PackedLayer<B>],
    [mut x, mut y]: [&'a mut [f32]; 2],
    (features, compression): (&[f32], Compression),
    arch: pulp::Arch,
) -> &'a [f32] {
    let (inputs, outputs) = match layers {
        [first, .., last] => (first.inputs, last.outputs),
        [only] => (only.inputs, only.outputs),
        [] => (0, 0),
    };
    let count = features.len().min(inputs);
    x[..count].copy_from_slice(&features[..count]);
    x[count..inputs].fill(0.0);
    compression.apply(&mut x[..inputs]);
    for layer in layers {
        sums(layer, &x[..layer.inputs], &mut y[..layer.padded()], arch);
        activate(layer.activation, &mut y[..layer.outputs]);
        core::mem::swap(&mut x, &mut y);
    }
    &x[..outputs]
}

fn activate(activation: Activation, y: &mut [f32]) {
    match activation {
        Activation::None => {}
        Activation::Relu => relu(y),
        Activation::Tanh => y.iter_mut().for_each(|y| *y = y.tanh()),
    }
}

/// `max(0, y)`.
pub(crate) fn relu(y: &mut [f32]) {
    // `max` would turn NaN into 0 and hide it.
    y.iter_mut()
        .for_each(|y| *y = if *y < 0.0 { 0.0 } else { *y });
}

/// A layer's sums over its inputs, padded.
pub(crate) fn sums<B: AsRef<[[f32; BLOCK]]>>(
    layer: &PackedLayer<B>,
    x: &[f32],
    y: &mut [f32],
    arch: pulp::Arch,
) {
    let blocks = layer.blocks.as_ref();
    arch.dispatch(Product { blocks, x, y });
}

/// One layer's sums, compiled for each width of vectors and chosen at run time.
struct Product<'a> {
    blocks: &'a [[f32; BLOCK]],
    x: &'a [f32],
    y: &'a mut [f32],
}

impl pulp::NullaryFnOnce for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let rows = 1 + self.x.len();
        let blocks = self.blocks.chunks_exact(rows);
        for (block, y) in blocks.zip(self.y.chunks_exact_mut(BLOCK)) {
            let Some((bias, weights)) = block.split_first() else {
                return;
            };
            let mut sums = *bias;
            for (weights, &x) in weights.iter().zip(self.x) {
                for (sum, weight) in sums.iter_mut().zip(weights) {
                    *sum += weight * x;
                }
            }
            y.copy_from_slice(&sums);
        }
    }
}
