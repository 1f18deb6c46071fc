//! Layers of a policy's network: how a file holds them, and what they answer.

use safetensors::{Dtype, SafeTensors};
use serde::Deserialize;

use crazyflie_env::action::ACTION;
use crazyflie_env::scalar::{Scalar, tabulate};

/// More than these is another kind of file.
pub(super) const MOST_LAYERS: usize = 8;

/// Function behind a dense layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Activation {
    #[default]
    Identity,
    Tanh,
    Relu,
    Elu,
    Silu,
    Sigmoid,
}

impl Activation {
    #[inline(always)]
    fn apply<R: Scalar>(self, x: R) -> R {
        let (zero, one) = (R::zero(), R::from_f64(1.0));
        match self {
            Activation::Identity => x,
            Activation::Tanh => tanh(x),
            Activation::Relu => x.max(zero),
            Activation::Elu => R::select(x.lt(zero), x.min(zero).exp() - one, x),
            Activation::Silu => x * sigmoid(x),
            Activation::Sigmoid => sigmoid(x),
        }
    }

    /// The same of `x` in C.
    pub(super) fn c(self) -> &'static str {
        match self {
            Activation::Identity => "x",
            Activation::Tanh => "tanhf(x)",
            Activation::Relu => "(x > 0.0f ? x : 0.0f)",
            Activation::Elu => "(x < 0.0f ? expf(x) - 1.0f : x)",
            Activation::Silu => "x / (1.0f + expf(-x))",
            Activation::Sigmoid => "1.0f / (1.0f + expf(-x))",
        }
    }
}

/// Kind of a layer, as the metadata of a file names it.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)]
pub(super) enum LayerKind {
    /// Weights and biases, then a function.
    Dense {
        #[serde(default)]
        activation: Activation,
    },
    /// Gated recurrent unit with the gates of PyTorch's `GRUCell`: reset, update, new.
    Gru {},
}

/// Weights (inputs rows of outputs) and biases.
#[derive(Debug)]
pub(super) struct Weights {
    pub weights: Vec<f32>,
    pub bias: Vec<f32>,
}

impl Weights {
    /// Adds the products of the inputs to biases.
    #[inline(always)]
    fn answer<R: Scalar>(&self, inputs: &[R], outputs: &mut Vec<R>) {
        outputs.clear();
        outputs.extend(self.bias.iter().map(|bias| R::from_f64((*bias).into())));
        for (x, weights) in inputs.iter().zip(self.weights.chunks_exact(self.bias.len())) {
            outputs.iter_mut().zip(weights).for_each(|(y, weight)| *y += *x * R::from_f64((*weight).into()));
        }
    }
}

#[derive(Debug)]
pub(super) enum Layer {
    Dense { weights: Weights, activation: Activation },
    Gru { inputs: Weights, memory: Weights },
}

impl Layer {
    pub(super) fn outputs(&self) -> usize {
        match self {
            Layer::Dense { weights, .. } => weights.bias.len(),
            Layer::Gru { memory, .. } => memory.bias.len() / 3,
        }
    }

    /// Numbers that it remembers.
    pub(super) fn memory(&self) -> usize {
        match self {
            Layer::Dense { .. } => 0,
            Layer::Gru { .. } => self.outputs(),
        }
    }
}

/// Layers between normalised inputs and an action.
#[derive(Debug)]
pub(super) struct Network {
    pub mean: Vec<f32>,
    pub std: Vec<f32>,
    /// Normalised inputs beyond so many standard deviations are cut off; infinite for none.
    pub clip: f64,
    pub layers: Vec<Layer>,
    /// A linear function beside the layers: a row of four for each input; empty if there is none.
    pub skip: Vec<f32>,
}

/// Numbers of one drone, or of lanes, that a network works with.
#[derive(Debug, Clone)]
pub(super) struct Scratch<R> {
    /// Inputs, which the caller fills, and outputs of a layer.
    pub layer: [Vec<R>; 2],
    gates: [Vec<R>; 2],
    /// Memory of the recurrent layers, one after the other.
    pub memory: Vec<R>,
}

impl<R: Scalar> Scratch<R> {
    pub(super) fn new(network: &Network) -> Self {
        Scratch {
            layer: [Vec::new(), Vec::new()],
            gates: [Vec::new(), Vec::new()],
            memory: vec![R::zero(); network.layers.iter().map(Layer::memory).sum()],
        }
    }

    /// Forgets what recurrent layers remember in the lanes of `mask`.
    pub(super) fn forget(&mut self, mask: R::Mask) {
        self.memory.iter_mut().for_each(|number| *number = R::select(mask, R::zero(), *number));
    }
}

impl Network {
    /// Returns the answer to the inputs in the first layer of `scratch`.
    #[inline(always)]
    pub(super) fn answer<R: Scalar>(&self, scratch: &mut Scratch<R>) -> [R; ACTION] {
        let Scratch { layer: [x, y], gates: [from_input, from_memory], memory } = scratch;
        let clip = R::from_f64(self.clip);
        for ((x, mean), std) in x.iter_mut().zip(&self.mean).zip(&self.std) {
            *x = ((*x - R::from_f64((*mean).into())) / R::from_f64((*std).into())).clamp(-clip, clip);
        }
        let mut linear = [R::zero(); ACTION];
        for (x, weights) in x.iter().zip(self.skip.as_chunks::<ACTION>().0) {
            linear.iter_mut().zip(weights).for_each(|(y, weight)| *y += *x * R::from_f64((*weight).into()));
        }
        let mut memory = &mut memory[..];
        for layer in &self.layers {
            match layer {
                Layer::Dense { weights, activation } => {
                    weights.answer(x, y);
                    y.iter_mut().for_each(|y| *y = activation.apply(*y));
                }
                Layer::Gru { inputs, memory: recurrent } => {
                    let size = layer.outputs();
                    let (kept, rest) = memory.split_at_mut(size);
                    memory = rest;
                    inputs.answer(x, from_input);
                    recurrent.answer(kept, from_memory);
                    y.clear();
                    for (i, kept) in kept.iter_mut().enumerate() {
                        let reset = sigmoid(from_input[i] + from_memory[i]);
                        let update = sigmoid(from_input[size + i] + from_memory[size + i]);
                        let new = tanh(from_input[2 * size + i] + reset * from_memory[2 * size + i]);
                        *kept = new + update * (*kept - new);
                        y.push(*kept);
                    }
                }
            }
            std::mem::swap(x, y);
        }
        tabulate(
            #[inline(always)]
            |i| x[i] + linear[i],
        )
    }
}

/// Absolute error below 3e-7 in `f32`.
#[inline(always)]
fn tanh<R: Scalar>(x: R) -> R {
    R::from_f64(1.0) - R::from_f64(2.0) / ((x + x).exp() + R::from_f64(1.0))
}

#[inline(always)]
fn sigmoid<R: Scalar>(x: R) -> R {
    R::from_f64(1.0) / (R::from_f64(1.0) + (-x).exp())
}

/// A tensor of finite single-precision numbers with so many dimensions, and its shape.
pub(super) fn tensor(
    tensors: &SafeTensors<'_>,
    name: &str,
    dimensions: usize,
) -> Result<(Vec<f32>, Vec<usize>), String> {
    let view = tensors.tensor(name).map_err(|_| format!("it lacks {name}"))?;
    let (kind, shape) = (view.dtype(), view.shape());
    if kind != Dtype::F32 || shape.len() != dimensions {
        let expected = format!("F32 with {dimensions} dimension(s)");
        return Err(format!("{name} is {kind:?} with shape {shape:?}, expected {expected}"));
    }
    let (words, _) = view.data().as_chunks::<4>();
    let values: Vec<f32> = words.iter().map(|word| f32::from_le_bytes(*word)).collect();
    match values.iter().find(|value| !value.is_finite()) {
        Some(value) => Err(format!("{name} holds {value}, expected finite numbers")),
        None => Ok((values, shape.to_vec())),
    }
}

/// A tensor of so many numbers, in order.
pub(super) fn vector(tensors: &SafeTensors<'_>, name: &str, length: usize) -> Result<Vec<f32>, String> {
    match tensor(tensors, name, 1)? {
        (values, _) if values.len() == length => Ok(values),
        (values, _) => Err(format!("{name} has {} numbers, expected {length}", values.len())),
    }
}

/// Standard deviations: positive numbers.
pub(super) fn deviations(tensors: &SafeTensors<'_>, name: &str, length: usize) -> Result<Vec<f32>, String> {
    let values = vector(tensors, name, length)?;
    match values.iter().find(|value| **value <= 0.0) {
        Some(zero) => Err(format!("{name} holds {zero}, expected positive numbers")),
        None => Ok(values),
    }
}

/// Weights from so many inputs: `{name}.{weight}` and `{name}.{bias}`.
fn weights(
    tensors: &SafeTensors<'_>,
    name: &str,
    [weight, bias]: [&str; 2],
    inputs: usize,
) -> Result<Weights, String> {
    let (weights, shape) = tensor(tensors, &format!("{name}.{weight}"), 2)?;
    let (bias, _) = tensor(tensors, &format!("{name}.{bias}"), 1)?;
    if shape[0] != inputs || shape[1] != bias.len() || bias.is_empty() {
        return Err(format!(
            "{name} has weights {shape:?} and {} biases, expected {inputs} inputs and as many biases as outputs",
            bias.len()
        ));
    }
    Ok(Weights { weights, bias })
}

/// `layer0`, `layer1`, ... of these kinds, from so many inputs to an action.
pub(super) fn layers(
    tensors: &SafeTensors<'_>,
    kinds: &[LayerKind],
    mut inputs: usize,
) -> Result<Vec<Layer>, String> {
    let mut layers = Vec::new();
    for (i, kind) in kinds.iter().enumerate() {
        let name = format!("layer{i}");
        let dense = weights(tensors, &name, ["weight", "bias"], inputs)?;
        let layer = match kind {
            LayerKind::Dense { activation } => Layer::Dense { weights: dense, activation: *activation },
            LayerKind::Gru {} => {
                let names = ["recurrent_weight", "recurrent_bias"];
                let memory = weights(tensors, &name, names, dense.bias.len() / 3)?;
                if memory.bias.len() != dense.bias.len() || !dense.bias.len().is_multiple_of(3) {
                    let (got, want) = (memory.bias.len(), dense.bias.len());
                    return Err(format!(
                        "{name} has {want} biases and {got} recurrent ones, expected three for each memory"
                    ));
                }
                Layer::Gru { inputs: dense, memory }
            }
        };
        inputs = layer.outputs();
        layers.push(layer);
    }
    if !(1..=MOST_LAYERS).contains(&layers.len()) || inputs != ACTION {
        let count = layers.len();
        return Err(format!(
            "{count} layers end in {inputs} numbers, expected 1 to {MOST_LAYERS} that end in {ACTION}"
        ));
    }
    Ok(layers)
}
