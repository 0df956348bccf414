"""Value networks Q(position, goal) -> one value per action, concatenated and two-stream (section 3.3.3), and dueling.

Layers start like PyTorch's: weights and biases uniform in +-1/sqrt(inputs).
"""

from functools import partial
from itertools import accumulate, pairwise
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def leaky_relu(x: Array) -> Array:
    """Slope 0.01 below zero (equation 3.20)."""
    return jnp.maximum(x, 0.01 * x)


def _linear(n_inputs: int, n_outputs: int, uniform: Float[Array, " parameters"]) -> eqx.nn.Linear:
    matrix = (uniform / jnp.sqrt(n_inputs)).reshape(n_outputs, n_inputs + 1)
    layer = eqx.nn.Linear(n_inputs, n_outputs, key=jax.random.key(0))
    return eqx.tree_at(lambda layer: (layer.weight, layer.bias), layer, (matrix[:, :-1], matrix[:, -1]))


class MultilayerPerceptron(eqx.Module):
    """Linear layers with leaky ReLU between them and a linear output (section 3.2.1)."""

    layers: tuple[eqx.nn.Linear, ...]

    def __init__(self, sizes: tuple[int, ...], key: Array):
        ends = list(accumulate((a + 1) * b for a, b in pairwise(sizes)))
        uniform = jnp.split(jax.random.uniform(key, (ends[-1],), minval=-1.0, maxval=1.0), ends[:-1])  # one draw compiles faster
        self.layers = tuple(_linear(a, b, draws) for (a, b), draws in zip(pairwise(sizes), uniform, strict=True))

    def __call__(self, x: Float[Array, " inputs"]) -> Float[Array, " outputs"]:
        for layer in self.layers[:-1]:
            x = leaky_relu(layer(x))
        return self.layers[-1](x)


class ConcatenatedQ(eqx.Module):
    """Q(s || g): position and goal side by side into one perceptron."""

    network: MultilayerPerceptron

    def __init__(self, n_dimensions: int, n_actions: int, hidden: tuple[int, ...], key: Array):
        self.network = MultilayerPerceptron((2 * n_dimensions, *hidden, n_actions), key)

    def __call__(self, position: Float[Array, " dims"], goal: Float[Array, " dims"]) -> Float[Array, " actions"]:
        return self.network(jnp.concatenate([position, goal]))


class TwoStreamQ(eqx.Module):
    """phi(s)[action] . psi(g): an embedding per action of the position, one of the goal, and their dot product."""

    phi: MultilayerPerceptron
    psi: MultilayerPerceptron

    def __init__(self, n_dimensions: int, n_actions: int, hidden: tuple[int, ...], key: Array):
        key_phi, key_psi = jax.random.split(key)
        *inner, width = hidden
        self.phi = MultilayerPerceptron((n_dimensions, *inner, n_actions * width), key_phi)
        self.psi = MultilayerPerceptron((n_dimensions, *inner, width), key_psi)

    def __call__(self, position: Float[Array, " dims"], goal: Float[Array, " dims"]) -> Float[Array, " actions"]:
        goal_embedding = self.psi(goal)
        return self.phi(position).reshape(-1, goal_embedding.size) @ goal_embedding


class DuelingQ(eqx.Module):
    """Value + advantage - mean advantage (Wang et al. 2016, equation 9), position and goal side by side as in `ConcatenatedQ`.

    Value and advantages share all hidden layers but the last, of which each has its own. Those two are one layer of twice
    the width, the last one of `trunk`; its first half belongs to the value.
    """

    trunk: MultilayerPerceptron
    value: MultilayerPerceptron
    advantage: MultilayerPerceptron

    def __init__(self, n_dimensions: int, n_actions: int, hidden: tuple[int, ...], key: Array):
        key_trunk, key_value, key_advantage = jax.random.split(key, 3)
        *shared, width = hidden
        self.trunk = MultilayerPerceptron((2 * n_dimensions, *shared, 2 * width), key_trunk)
        self.value = MultilayerPerceptron((width, 1), key_value)
        self.advantage = MultilayerPerceptron((width, n_actions), key_advantage)

    def __call__(self, position: Float[Array, " dims"], goal: Float[Array, " dims"]) -> Float[Array, " actions"]:
        for_value, for_advantage = jnp.split(leaky_relu(self.trunk(jnp.concatenate([position, goal]))), 2)
        advantage = self.advantage(for_advantage)
        return self.value(for_value) + advantage - advantage.mean()


QNetwork = ConcatenatedQ | TwoStreamQ | DuelingQ
ARCHITECTURES: dict[str, type[ConcatenatedQ] | type[TwoStreamQ] | type[DuelingQ]] = {
    "concatenated": ConcatenatedQ,
    "two-stream": TwoStreamQ,
    "dueling": DuelingQ,
}


class Twins(eqx.Module):
    """Two networks of which the smaller value counts in targets (Fujimoto et al. 2018); the first one flies."""

    members: tuple[QNetwork, QNetwork]


Networks = QNetwork | Twins


def members(networks: Networks) -> tuple[QNetwork, ...]:
    """The networks one by one, the one that flies first."""
    return networks.members if isinstance(networks, Twins) else (networks,)


Tree = TypeVar("Tree", bound=Networks)


def fold(network: Tree) -> Tree:
    """The same tree with each linear layer as one matrix `[outputs, inputs + 1]`, the bias its last column.

    For `action_values`, which is several times as fast on a CPU as mapping the network over a batch.
    """
    matrix = lambda layer: jnp.concatenate([layer.weight, layer.bias[:, None]], axis=1)
    return jax.tree.map(matrix, network, is_leaf=lambda node: isinstance(node, eqx.nn.Linear))


def unfold(folded: Tree, like: Tree) -> Tree:
    """The inverse of `fold`; `like` is any network of the same architecture."""
    parts = lambda layer: (layer.weight, layer.bias)
    layer = lambda matrix, old: eqx.tree_at(parts, old, (matrix[:, :-1], matrix[:, -1]))
    return jax.tree.map(layer, folded, like)


def action_values(
    folded: QNetwork, position: Float[Array, "dims batch"], goal: Float[Array, "dims batch"], n_gradient: int
) -> Float[Array, "actions batch"]:
    """Q of a batch of (position, goal), each a column; gradients flow through the first `n_gradient` columns only.

    That limit lets one call serve the states that are learned from and those that only make targets.
    """
    if isinstance(folded, ConcatenatedQ):
        return perceptron(n_gradient, folded.network.layers, jnp.concatenate([position, goal]))
    if isinstance(folded, DuelingQ):
        return perceptron(n_gradient, (*folded.trunk.layers, _aggregation(folded)), jnp.concatenate([position, goal]))
    phi = perceptron(n_gradient, folded.phi.layers, position)
    psi = perceptron(n_gradient, folded.psi.layers, goal)
    # Not `(phi * psi).sum(1)`: jax 0.10.2 compiles that for CPUs to reads of memory never written, from some hundred columns on.
    return jnp.einsum("akb,kb->ab", phi.reshape(-1, *psi.shape), psi)


def _aggregation(folded: DuelingQ) -> Float[Array, "actions inputs"]:
    """Value + advantage - mean advantage is linear in what enters it: the last matrix of one perceptron."""
    value, advantage = jax.tree.leaves((folded.value, folded.advantage))
    advantage = advantage - advantage.mean(0)
    value = jnp.broadcast_to(value, (len(advantage), value.shape[1]))
    return jnp.concatenate([value[:, :-1], advantage[:, :-1], value[:, -1:] + advantage[:, -1:]], axis=1)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def perceptron(
    n_gradient: int, matrices: tuple[Float[Array, "_ _"], ...], x: Float[Array, "inputs batch"]
) -> Float[Array, "outputs batch"]:
    """`MultilayerPerceptron` over the columns of `x`, with its backward pass written by hand; none flows into `x`.

    Columns, because a product whose last axis is the batch (a multiple of 16) meets the fast kernels; the bias as one more
    column, because it then needs no product, sum and optimiser step of its own; transposes made before the products
    (`optimization_barrier` keeps the compiler from merging them), because products of transposed matrices are slower.
    Measured in docs/speed.md.
    """
    return _perceptron_forward(n_gradient, matrices, x)[0]


Residuals = tuple[tuple[Array, ...], tuple[Array, ...]]


def _perceptron_forward(n_gradient: int, matrices: tuple[Array, ...], x: Array) -> tuple[Array, Residuals]:
    inputs = []
    for i, matrix in enumerate(matrices):
        x = leaky_relu(x) if i else x
        inputs.append(jnp.concatenate([x, jnp.ones((1, x.shape[1]), x.dtype)]))
        x = matrix @ inputs[-1]
    return _copy(x), (matrices, tuple(inputs))


def _perceptron_backward(n_gradient: int, residuals: Residuals, upstream: Array) -> tuple[tuple[Array, ...], None]:
    matrices, inputs = residuals
    upstream = upstream[:, :n_gradient]
    gradients = []
    for i in reversed(range(len(matrices))):
        entered = inputs[i][:, :n_gradient]
        gradients.append(upstream @ _copy(entered.T))
        if i:
            slope = jnp.where(entered[:-1] > 0, 1.0, 0.01)
            upstream = (_copy(matrices[i][:, :-1].T) @ upstream) * slope
    return tuple(gradients[::-1]), None


perceptron.defvjp(_perceptron_forward, _perceptron_backward)


def _copy(x: Array) -> Array:
    return jax.lax.optimization_barrier(x)


def parameter_count(network: QNetwork) -> int:
    """Number of trainable parameters: 5,554 for the thesis's network in 2D, 5,756 in 3D."""
    return sum(leaf.size for leaf in jax.tree.leaves(eqx.filter(network, eqx.is_array)))
