"""Value networks Q(position, goal) -> one value per action, section 3.3.3: concatenated and two-stream.

`equinox.nn.Linear` starts like PyTorch's: weights and biases uniform in +-1/sqrt(inputs).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def leaky_relu(x: Array) -> Array:
    """Slope 0.01 below zero (equation 3.20)."""
    return jnp.maximum(x, 0.01 * x)


class MultilayerPerceptron(eqx.Module):
    """Linear layers with leaky ReLU between them and a linear output (section 3.2.1)."""

    layers: tuple[eqx.nn.Linear, ...]

    def __init__(self, sizes: tuple[int, ...], key: Array):
        keys = jax.random.split(key, len(sizes) - 1)
        self.layers = tuple(eqx.nn.Linear(a, b, key=k) for a, b, k in zip(sizes[:-1], sizes[1:], keys, strict=True))

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


QNetwork = ConcatenatedQ | TwoStreamQ
ARCHITECTURES: dict[str, type[ConcatenatedQ] | type[TwoStreamQ]] = {"concatenated": ConcatenatedQ, "two-stream": TwoStreamQ}


def parameter_count(network: QNetwork) -> int:
    """Number of trainable parameters: 5,554 for the thesis's network in 2D, 5,756 in 3D."""
    return sum(leaf.size for leaf in jax.tree.leaves(eqx.filter(network, eqx.is_array)))
