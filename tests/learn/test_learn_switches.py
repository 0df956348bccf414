"""The switches of DDQN-HER that the thesis does not have: each trains, each does what its equation says, all work together."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from cellpilot.envs.arena import Arena, make_arena
from cellpilot.learn.algorithms.ddqn_episode import LearnerState
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER, DDQNHERVariants
from cellpilot.learn.algorithms.ddqn_her_variants import ALGORITHM, initial_state, optimize
from cellpilot.learn.checkpoint import load_state, named_leaves, save_state
from cellpilot.learn.compiled import train_chunk
from cellpilot.learn.learner import Place
from cellpilot.learn.losses import q_learning_target
from cellpilot.learn.n_step import outcome_of_steps
from cellpilot.learn.networks import Networks, members
from cellpilot.learn.prioritised import importance_weights, renew_priorities
from cellpilot.learn.replay import draw_rows
from cellpilot.learn.trainer import TrainingResult, train_many, train_one
from cellpilot.task import Task
from cellpilot.world import World

TASK = Task(rho_blocked=-0.5, max_steps=12)
SMALL = DDQNHERVariants(
    episodes=8,
    batch_size=8,
    replay_capacity=900,
    replay_start=60,
    updates_per_episode=3,
    target_period=3,
    hidden_layers=2,
    hidden_units=8,
)
SWITCHES = {
    "dueling": {"architecture": "dueling"},
    "three steps": {"n_steps": 3},
    "prioritised": {"prioritised": True},
    "two networks": {"networks": 2},
}
ALL = SMALL.changed(**{name: value for change in SWITCHES.values() for name, value in change.items()})


@pytest.fixture(scope="module")
def place(random_world: Callable[..., World]) -> Place:
    return Place(random_world(5, (4, 3, 1), 0.15, noise_std_db=2.0, sinr_std_db=1.0), TASK)


@pytest.fixture(scope="module")
def arena(place: Place) -> Arena:
    return make_arena(place.world)


@pytest.fixture(scope="module")
def together(place: Place) -> TrainingResult:
    """All switches at once, in two chunks."""
    return train_one(ALL, place, 3, chunk_rounds=4)


def flying(state: LearnerState) -> np.ndarray:
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(members(state.online)[0])])


def assert_equal_bitwise(one: object, two: object) -> None:
    first, second = named_leaves(one), named_leaves(two)
    assert first.keys() == second.keys()
    for name, leaf in first.items():
        assert np.asarray(leaf).tobytes() == np.asarray(second[name]).tobytes(), name


def test_each_switch_trains_another_policy_and_the_same_again(arena: Arena) -> None:
    policies = set()
    for change in list(SWITCHES.values())[1:]:  # dueling trains with the others below
        settings = SMALL.changed(**change)
        options = {"algorithm": ALGORITHM, "settings": settings, "task": TASK, "length": SMALL.episodes}
        once, again = (
            train_chunk(initial_state(settings, arena, 3), arena, jnp.int32(3), jnp.int32(SMALL.episodes), **options)[0]
            for _ in range(2)
        )
        assert_equal_bitwise(once, again)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(once))
        policies.add(flying(once).tobytes())
    assert len(policies) == 3


def test_all_switches_together_train_and_are_saved(tmp_path: Path, arena: Arena, together: TrainingResult) -> None:
    assert together.finished
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(together.state))
    parameters = together.policy_parameters({})
    assert parameters.architecture == "dueling"
    assert sum(tensor.size for tensor in parameters.tensors.values()) == flying(together.state).size  # one network flies
    path, identity = tmp_path / "state.safetensors", {"seed": 3, "fingerprint": ""}
    save_state(path, together.state, together.history, identity | {"train_wall_s": 1.0})
    again, _, _ = load_state(path, initial_state(ALL, arena, 0), identity)
    assert_equal_bitwise(again, together.state)


def test_seeds_at_once_are_the_trainings_they_would_be_alone(place: Place, together: TrainingResult) -> None:
    found, other = train_many(ALL, place, (3, 4), chunk_rounds=4)
    expected = named_leaves(together.state)
    for name, leaf in named_leaves(found.state).items():
        np.testing.assert_allclose(leaf, expected[name], atol=2e-5, err_msg=name)
    assert (flying(found.state) != flying(other.state)).any()


def test_an_update_with_every_switch_is_its_equations(arena: Arena, together: TrainingResult) -> None:
    """Two updates with everything on, written out network by network for the same rows; online and target all differ."""
    settings, key = ALL.changed(updates_per_episode=2), jax.random.key(5)
    state = replace(together.state, target=initial_state(ALL, arena, 99).online, episode=jnp.int32(2))
    found = jax.jit(optimize, static_argnums=(1, 3))(key, settings, arena, TASK, state)
    experiences, priority = state.replay.experiences, state.replay.priority
    assert priority is not None
    rows = draw_rows(key, state.replay, (2, settings.batch_size))
    weights = importance_weights(priority, rows, state.replay.size, jnp.float32(0.4 + 0.6 * 2 / 8))
    adam = optax.adam(settings.learning_rate)
    at = lambda cells: arena.coordinates[cells]

    @jax.jit
    def update(online: Networks, moments: optax.OptState, row: jax.Array, weight: jax.Array) -> tuple:
        outcome = outcome_of_steps(state.replay, row, TASK, 3, 3)
        there, goal = at(outcome.next_cell), at(experiences.goal[row])
        first, second = (jax.vmap(network)(there, goal) for network in members(state.target))
        least, chooser = jnp.minimum(first, second), jax.vmap(members(online)[0])(there, goal)
        target = q_learning_target(outcome.reward, outcome.terminated, chooser, least, outcome.discount, True)
        target = jnp.clip(target, *TASK.value_bounds())

        def errors(networks: Networks) -> jax.Array:
            q = [jax.vmap(network)(at(experiences.transition.cell[row]), goal) for network in members(networks)]
            return target - jnp.stack([values[jnp.arange(len(row)), experiences.transition.action[row]] for values in q])

        gradient = jax.grad(lambda networks: (weight * jnp.square(errors(networks))).mean(1).sum())(online)
        changes, moments = adam.update(gradient, moments)
        return optax.apply_updates(online, changes), moments, jnp.abs(errors(online)).mean(0), first - second, outcome.discount

    online = state.online
    before, error = state.optimizer, []
    moments, *rest = adam.init(online)
    moments = (moments._replace(count=before.n_steps, mu=before.mu, nu=before.nu), *rest)
    for row, weight in zip(rows, weights, strict=True):
        online, moments, errors, between, discount = update(online, moments, row, weight)
        error.append(errors)
        assert (np.asarray(between) > 0).any()
        assert (np.asarray(between) < 0).any()
        assert len(set(np.asarray(discount).tolist())) > 1
    for name, leaf in named_leaves(online).items():
        np.testing.assert_allclose(named_leaves(found.online)[name], leaf, atol=1e-5, err_msg=name)
    expected = renew_priorities(priority, rows, jnp.stack(error), settings.priority_exponent)
    np.testing.assert_allclose(found.replay.priority, expected, rtol=1e-3)
    assert len(set(np.asarray(priority)[: int(state.replay.size)].tolist())) > 10  # else all chances had been alike


def test_two_networks_start_apart_and_the_first_as_it_would_alone(arena: Arena) -> None:
    alone, twins = (initial_state(SMALL.changed(networks=n), arena, 7) for n in (1, 2))
    first, second = members(twins.online)
    for one, two, other in zip(*map(jax.tree.leaves, (alone.online, first, second)), strict=True):
        np.testing.assert_array_equal(one, two)
        assert (np.asarray(one) != np.asarray(other)).all()


def test_without_a_switch_it_is_the_published_algorithm_bit_for_bit(place: Place) -> None:
    published = DDQNHER(**{name: getattr(SMALL, name) for name in DDQNHER.model_fields if name != "algorithm"})
    one, other = (train_one(settings, place, 3) for settings in (published, SMALL))
    assert_equal_bitwise(one.state, other.state)
    for name, column in one.history.items():
        np.testing.assert_array_equal(column, other.history[name])
