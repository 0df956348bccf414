import json
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from safetensors.numpy import save_file

from cellpilot.envs.arena import make_arena
from cellpilot.errors import InputError
from cellpilot.learn.checkpoint import named_leaves, policy_parameters
from cellpilot.learn.networks import (
    ARCHITECTURES,
    ConcatenatedQ,
    DuelingQ,
    MultilayerPerceptron,
    QNetwork,
    TwoStreamQ,
    action_values,
    fold,
    leaky_relu,
    parameter_count,
    unfold,
)
from cellpilot.policies import LearnedPolicy, PolicyParameters, load_parameters
from cellpilot.policies.learned import save_parameters
from cellpilot.world import World

MakeWorld = Callable[..., World]


@pytest.mark.parametrize(("dimensions", "actions", "count"), [(2, 4, 5_554), (3, 6, 5_756)])
def test_parameter_counts_of_the_thesis(dimensions: int, actions: int, count: int) -> None:
    assert parameter_count(ConcatenatedQ(dimensions, actions, (50, 50, 50), jax.random.key(0))) == count


def test_layers_start_like_those_of_pytorch() -> None:
    """Weights and biases uniform within +-1/sqrt(inputs), every layer with its own draw."""
    network = MultilayerPerceptron((64, 100, 100, 5), jax.random.key(0))
    for layer, inputs in zip(network.layers, (64, 100, 100), strict=True):
        bound = 1 / np.sqrt(inputs)
        weight, bias = np.asarray(layer.weight), np.asarray(layer.bias)
        assert np.abs(weight).max() <= bound
        assert np.abs(bias).max() <= bound
        assert np.abs(bias).max() > 0
        quantiles = np.quantile(weight, [0.1, 0.25, 0.5, 0.75, 0.9]) / bound
        np.testing.assert_allclose(quantiles, [-0.8, -0.5, 0.0, 0.5, 0.8], atol=5 / np.sqrt(weight.size))
    assert not np.allclose(network.layers[1].weight[:5], network.layers[2].weight)


def test_leaky_relu_by_hand() -> None:
    np.testing.assert_allclose(leaky_relu(jnp.array([-2.0, 0.0, 3.0])), [-0.02, 0.0, 3.0])


def plain_perceptron(network: MultilayerPerceptron, x: np.ndarray) -> np.ndarray:
    for i, layer in enumerate(network.layers):
        x = np.asarray(layer.weight, np.float64) @ x + np.asarray(layer.bias, np.float64)
        x = np.where(x > 0, x, 0.01 * x) if i < len(network.layers) - 1 else x
    return x


def test_concatenated_network_by_hand() -> None:
    network = ConcatenatedQ(2, 4, (7, 5), jax.random.key(0))
    position, goal = np.array([0.3, 1.0]), np.array([0.75, 0.1])
    expected = plain_perceptron(network.network, np.concatenate([position, goal]))
    np.testing.assert_allclose(network(jnp.asarray(position), jnp.asarray(goal)), expected, rtol=1e-5)


def test_two_stream_network_by_hand() -> None:
    network = TwoStreamQ(3, 6, (7, 5), jax.random.key(0))
    position, goal = np.array([0.3, 1.0, 0.2]), np.array([0.75, 0.1, 0.4])
    phi, psi = plain_perceptron(network.phi, position), plain_perceptron(network.psi, goal)
    assert (phi.shape, psi.shape) == ((6 * 5,), (5,))
    expected = [sum(phi[5 * action + i] * psi[i] for i in range(5)) for action in range(6)]
    np.testing.assert_allclose(network(jnp.asarray(position), jnp.asarray(goal)), expected, rtol=1e-4)


@pytest.mark.parametrize("hidden", [(7, 5), (5,)])
def test_dueling_network_by_hand(hidden: tuple[int, ...]) -> None:
    network = DuelingQ(2, 4, hidden, jax.random.key(0))
    position, goal = np.array([0.3, 1.0]), np.array([0.75, 0.1])
    streams = plain_perceptron(network.trunk, np.concatenate([position, goal]))
    streams = np.where(streams > 0, streams, 0.01 * streams)
    assert streams.shape == (2 * 5,)
    value, advantage = plain_perceptron(network.value, streams[:5]), plain_perceptron(network.advantage, streams[5:])
    assert (value.shape, advantage.shape) == ((1,), (4,))
    found = network(jnp.asarray(position), jnp.asarray(goal))
    np.testing.assert_allclose(found, [value[0] + a - sum(advantage) / 4 for a in advantage], rtol=1e-4)
    np.testing.assert_allclose(np.mean(found), value[0], rtol=1e-4)  # the advantages have mean 0
    assert np.std(advantage) > 0.01


def trained_on(world: World, architecture: str, seed: int = 0) -> tuple[eqx.Module, PolicyParameters]:
    dimensions, actions = world.grid.n_dimensions, world.airspace.n_actions
    network = ARCHITECTURES[architecture](dimensions, actions, (16, 12), jax.random.key(seed))
    return network, policy_parameters(network, architecture, world.grid.sides, {"seed": seed, "scenario": "test"})


@pytest.mark.parametrize("architecture", ARCHITECTURES)
@pytest.mark.parametrize("sides", [(4, 5, 1), (3, 2, 4)])
def test_the_policy_flies_on_numpy_as_the_network_does(
    make_world: MakeWorld, sides: tuple[int, int, int], architecture: str
) -> None:
    world = make_world(sides)
    network, parameters = trained_on(world, architecture)
    goals = np.array([5, 0, world.grid.n_cells - 1], np.int32)
    coordinates = make_arena(world).coordinates
    values = jax.vmap(jax.vmap(network, (None, 0)), (0, None))(coordinates, coordinates[goals])
    found = parameters.values(world.grid, goals)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, values, rtol=1e-4, atol=1e-5)

    best = LearnedPolicy(parameters, world.grid)
    np.testing.assert_array_equal(best.action_probabilities(goals).argmax(-1), np.asarray(values).argmax(-1))
    assert (best.name, best.deterministic) == ("learned/argmax", True)
    soft = LearnedPolicy(parameters, world.grid, 0.05)
    np.testing.assert_allclose(soft.action_probabilities(goals), jax.nn.softmax(values / 0.05, -1), atol=1e-4)
    assert (soft.name, soft.deterministic) == ("learned/boltzmann-0.05", False)


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_policy_file_round_trip(tmp_path: Path, make_world: MakeWorld, architecture: str) -> None:
    world = make_world((4, 5, 1))
    _, parameters = trained_on(world, architecture)
    path = tmp_path / "policy.safetensors"
    save_parameters(parameters, path)
    again = load_parameters(path)
    assert (again.architecture, again.sides, again.about) == (architecture, (4, 5, 1), {"seed": 0, "scenario": "test"})
    goals = np.arange(20, dtype=np.int32)
    np.testing.assert_array_equal(again.values(world.grid, goals), parameters.values(world.grid, goals))


def test_a_policy_of_another_grid_is_refused(make_world: MakeWorld) -> None:
    _, parameters = trained_on(make_world((4, 5, 1)), "concatenated")
    for sides in ((5, 4, 1), (4, 5, 2)):
        grid = make_world(sides).grid
        with pytest.raises(InputError, match="4 x 5 x 1"):
            parameters.values(grid, np.array([0], np.int32))
        with pytest.raises(InputError, match="4 x 5 x 1"):
            LearnedPolicy(parameters, grid).action_probabilities(np.array([0], np.int32))


def test_files_that_are_no_policy(tmp_path: Path, make_world: MakeWorld) -> None:
    _, parameters = trained_on(make_world((4, 5, 1)), "concatenated")
    good = tmp_path / "good.safetensors"
    save_parameters(parameters, good)
    whole = good.read_bytes()
    bad = tmp_path / "bad.safetensors"
    with pytest.raises(InputError, match="no such file"):
        load_parameters(bad)
    for content in (b"", b"not a policy", whole[: len(whole) // 2], whole[:-1], whole[:20]):
        bad.write_bytes(content)
        with pytest.raises(InputError, match=r"bad\.safetensors"):
            load_parameters(bad)
    save_file(parameters.tensors, bad)
    with pytest.raises(InputError, match="cellpilot-policy-1"):
        load_parameters(bad)


@pytest.mark.parametrize("header", ["{", "{}", json.dumps({"architecture": "concatenated"}), None])
def test_a_policy_without_a_usable_description(tmp_path: Path, header: str | None) -> None:
    path = tmp_path / "policy.safetensors"
    metadata = {} if header is None else {"cellpilot-policy-1": header}
    save_file({"network.layers.0.weight": np.zeros((4, 4), np.float32)}, path, metadata=metadata)
    with pytest.raises(InputError):
        load_parameters(path)


def test_leaves_are_named_by_their_path() -> None:
    names = list(named_leaves(eqx.filter(ConcatenatedQ(2, 4, (3,), jax.random.key(0)), eqx.is_array)))
    assert names == [f"network.layers.{i}.{kind}" for i in range(2) for kind in ("weight", "bias")]


def folded_case(architecture: str) -> tuple[QNetwork, jax.Array, jax.Array]:
    """A network and a batch of positions and goals as columns."""
    network = ARCHITECTURES[architecture](2, 4, (12, 9, 7), jax.random.key(1))
    position, goal = jax.random.uniform(jax.random.key(2), (2, 2, 11), minval=-1.0, maxval=1.0)
    return network, position, goal


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_folding_keeps_every_parameter(architecture: str) -> None:
    network, _, _ = folded_case(architecture)
    blank = jax.tree.map(jnp.zeros_like, network)
    again, expected = named_leaves(unfold(fold(network), blank)), named_leaves(network)
    assert again.keys() == expected.keys()
    for name, leaf in expected.items():
        np.testing.assert_array_equal(again[name], leaf)


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_action_values_are_those_of_the_network_in_columns(architecture: str) -> None:
    network, position, goal = folded_case(architecture)
    expected = jax.vmap(network, (1, 1), 1)(position, goal)
    np.testing.assert_allclose(action_values(fold(network), position, goal, 0), expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("columns", [32, 64, 400, 960])
@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_compiled_action_values_are_those_of_the_network(architecture: str, columns: int) -> None:
    """As training compiles them: the thesis's layers, all cells towards one goal, many columns at once."""
    network = ARCHITECTURES[architecture](2, 4, (50, 50, 50), jax.random.key(0))
    position = jax.random.uniform(jax.random.key(1), (2, columns))
    compiled = jax.jit(lambda net, x, goal: action_values(fold(net), x, jnp.broadcast_to(goal[:, None], x.shape), 0).T)
    goal = jnp.array([0.4, 0.9])
    expected = jax.vmap(network, (1, None))(position, goal)
    for _ in range(3):
        np.testing.assert_allclose(compiled(network, position, goal), expected, atol=1e-5)


@pytest.mark.parametrize("n_gradient", [0, 4, 11])
@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_the_backward_pass_written_by_hand_is_the_gradient(architecture: str, n_gradient: int) -> None:
    network, position, goal = folded_case(architecture)
    weight = jax.random.normal(jax.random.key(3), (4, 11))

    def by_hand(folded: QNetwork) -> jax.Array:
        return (weight * jnp.sin(action_values(folded, position, goal, n_gradient))).sum()

    def derived(network: QNetwork) -> jax.Array:
        q = jax.vmap(network, (1, 1), 1)(position[:, :n_gradient], goal[:, :n_gradient])
        return (weight[:, :n_gradient] * jnp.sin(q)).sum()

    found, expected = unfold(jax.grad(by_hand)(fold(network)), network), jax.grad(derived)(network)
    for name, leaf in named_leaves(expected).items():
        np.testing.assert_allclose(named_leaves(found)[name], leaf, atol=1e-5, err_msg=name)
    assert (n_gradient > 0) == any(np.any(np.asarray(leaf)) for leaf in jax.tree.leaves(found))
