import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from cellpilot.learn.adam import adam_step, init_adam
from cellpilot.learn.exploration import NOISE, boltzmann_noise, epsilon_greedy_noise, linear_schedule
from cellpilot.learn.losses import q_learning_target, squared_td_error

Q = jnp.array([1.0, 2.0, 0.5, 1.9])
N = 40_000


def frequencies(noise: jax.Array) -> np.ndarray:
    return np.bincount(np.asarray((Q + noise).argmax(-1)), minlength=4) / len(noise)


@pytest.mark.parametrize("temperature", [0.1, 0.5, 2.0])
def test_boltzmann_noise_gives_the_boltzmann_distribution(temperature: float) -> None:
    found = frequencies(boltzmann_noise(jax.random.key(0), jnp.float32(temperature), (N, 4)))
    weights = np.exp(np.asarray(Q) / temperature)
    expected = weights / weights.sum()
    assert (np.abs(found - expected) < 5 * np.sqrt(expected * (1 - expected) / N) + 1e-4).all()


def test_no_temperature_is_arg_max() -> None:
    assert frequencies(boltzmann_noise(jax.random.key(0), jnp.float32(0.0), (50, 4))).tolist() == [0, 1, 0, 0]


@pytest.mark.parametrize("epsilon", [0.0, 0.3, 1.0])
def test_epsilon_greedy_noise_gives_epsilon_greedy(epsilon: float) -> None:
    found = frequencies(epsilon_greedy_noise(jax.random.key(1), jnp.float32(epsilon), (N, 4)))
    expected = np.full(4, epsilon / 4) + np.array([0, 1 - epsilon, 0, 0])
    assert (np.abs(found - expected) < 5 * np.sqrt(expected * (1 - expected) / N) + 1e-4).all()


@pytest.mark.parametrize("kind", NOISE)
def test_noise_differs_between_keys_and_steps(kind: str) -> None:
    draw = lambda seed: np.asarray(NOISE[kind](jax.random.key(seed), jnp.float32(1.0), (6, 4)))
    np.testing.assert_array_equal(draw(0), draw(0))
    assert (draw(0) != draw(1)).all()
    assert len(np.unique(draw(0))) == 24


@pytest.mark.parametrize(("progress", "value"), [(0.0, 2.0), (0.25, 1.05), (0.5, 0.1), (0.75, 0.1), (1.0, 0.1)])
def test_linear_schedule_by_hand(progress: float, value: float) -> None:
    assert float(linear_schedule(2.0, 0.1, 0.5, jnp.float32(progress))) == pytest.approx(value, abs=1e-6)


REWARD = jnp.array([1.0, -0.1, 10.0, 0.0])
TERMINATED = jnp.array([False, False, True, False])
ONLINE = jnp.array([[0.0, 5.0], [2.0, 1.0], [9.0, 9.5], [1.0, 1.0]])
TARGET = jnp.array([[3.0, -1.0], [0.5, 4.0], [8.0, 8.0], [-2.0, 6.0]])


def test_double_target_by_hand() -> None:
    """The online network chooses, the target network values; ties to the first action; termination ends the sum."""
    found = q_learning_target(REWARD, TERMINATED, ONLINE, TARGET, 0.9, double=True)
    np.testing.assert_allclose(found, [1.0 + 0.9 * -1.0, -0.1 + 0.9 * 0.5, 10.0, 0.0 + 0.9 * -2.0], rtol=1e-6)


def test_single_target_by_hand() -> None:
    found = q_learning_target(REWARD, TERMINATED, ONLINE, TARGET, 0.9, double=False)
    np.testing.assert_allclose(found, [1.0 + 0.9 * 3.0, -0.1 + 0.9 * 4.0, 10.0, 0.0 + 0.9 * 6.0], rtol=1e-6)


@pytest.mark.parametrize("double", [True, False])
def test_a_truncated_flight_bootstraps_and_a_terminated_one_does_not(double: bool) -> None:
    open_, closed = (q_learning_target(REWARD, jnp.full(4, end), ONLINE, TARGET, 0.9, double) for end in (False, True))
    np.testing.assert_allclose(closed, REWARD)
    assert (np.asarray(open_) != np.asarray(closed)).all()


def test_loss_by_hand() -> None:
    q = jnp.array([[1.0, 2.0, 3.0], [0.0, -1.0, 0.5]])
    action, target = jnp.array([2, 1]), jnp.array([2.0, 1.0])
    assert float(squared_td_error(q, action, target)) == pytest.approx(((2 - 3) ** 2 + (1 + 1) ** 2) / 2)
    gradient = jax.grad(squared_td_error)(q, action, target)
    np.testing.assert_allclose(gradient, [[0, 0, 3.0 - 2.0], [0, -1.0 - 1.0, 0]], atol=1e-6)  # 2 x (q - target) / 2


def test_no_gradient_flows_into_the_target() -> None:
    q, action = jnp.array([[1.0, 2.0], [0.0, -1.0]]), jnp.array([0, 1])
    gradient = jax.grad(squared_td_error, argnums=2)(q, action, jnp.array([2.0, 1.0]))
    np.testing.assert_array_equal(gradient, 0.0)

    def through_the_target(scale: jax.Array) -> jax.Array:
        target = q_learning_target(REWARD, TERMINATED, scale * ONLINE, scale * TARGET, 0.9, True)
        return squared_td_error(jnp.zeros((4, 2)), jnp.zeros(4, jnp.int32), target)

    assert float(jax.grad(through_the_target)(jnp.float32(1.0))) == 0.0


def test_adam_takes_the_steps_of_its_published_form() -> None:
    """Against optax, over steps of very different sizes, where the corrections of the start matter most."""
    parameters = {"a": jnp.array([1.0, -2.0, 0.5]), "b": jnp.array([[3.0]])}
    found, state, expected, adam = parameters, init_adam(parameters), parameters, optax.adam(1e-2)
    moments = adam.init(parameters)
    for i in range(6):
        gradient = jax.tree.map(lambda p, i=i: jnp.sin(p * (i + 1)) * 10.0 ** (i - 3), expected)
        found, state = adam_step(found, gradient, state, 1e-2)
        changes, moments = adam.update(gradient, moments)
        expected = optax.apply_updates(expected, changes)
        for name in parameters:
            np.testing.assert_allclose(found[name], expected[name], rtol=1e-5)
    assert int(state.n_steps) == 6
