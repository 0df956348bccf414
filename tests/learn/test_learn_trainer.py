from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from cellpilot.airspace import STOPPED
from cellpilot.envs.arena import Arena, make_arena
from cellpilot.errors import InputError
from cellpilot.learn.algorithms import ddqn_episode, ddqn_her, ddqn_her_variants
from cellpilot.learn.algorithms.ddqn_episode import LearnerState, collect, exploration_at
from cellpilot.learn.algorithms.ddqn_her import ALGORITHM, initial_state, optimize
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER, DDQNHERVariants
from cellpilot.learn.checkpoint import load_state, named_leaves, save_state
from cellpilot.learn.compiled import prepare_state, train_chunk
from cellpilot.learn.learner import Place
from cellpilot.learn.losses import q_learning_target
from cellpilot.learn.networks import QNetwork
from cellpilot.learn.replay import draw_rows
from cellpilot.learn.trainer import TrainingProgress, TrainingResult, train_one
from cellpilot.task import Task
from cellpilot.world import World

TASK = Task(rho_blocked=-0.5, max_steps=12)
SMALL = DDQNHER(
    episodes=24,
    batch_size=8,
    replay_capacity=900,
    replay_start=120,
    updates_per_episode=3,
    target_period=5,
    hidden_layers=2,
    hidden_units=8,
)
VARIANT = DDQNHERVariants(**SMALL.model_dump(exclude={"algorithm"}))
STATISTICS = ("episode_return", "n_steps", "reached")


@pytest.fixture(scope="module")
def place(random_world: Callable[..., World]) -> Place:
    """A 4 x 3 world with blocked cells, noise and an uncertain map: every source of randomness is on."""
    return Place(random_world(5, (4, 3, 1), 0.15, noise_std_db=2.0, sinr_std_db=1.0), TASK)


@pytest.fixture(scope="module")
def arena(place: Place) -> Arena:
    return make_arena(place.world)


@pytest.fixture(scope="module")
def uninterrupted(place: Place) -> TrainingResult:
    """The run that others are compared with."""
    return train_one(SMALL, place, seed=3, chunk_rounds=4)


def assert_equal_bitwise(one: object, two: object) -> None:
    first, second = named_leaves(one), named_leaves(two)
    assert first.keys() == second.keys()
    for name in first:
        assert first[name].dtype == second[name].dtype, name
        assert np.asarray(first[name]).tobytes() == np.asarray(second[name]).tobytes(), name


def assert_same_run(one: TrainingResult, two: TrainingResult) -> None:
    assert_equal_bitwise(one.state, two.state)
    assert one.history.keys() == two.history.keys()
    for name, column in one.history.items():
        np.testing.assert_array_equal(column, two.history[name])


def weights(network: QNetwork) -> np.ndarray:
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(network)])


def test_a_training_tells_what_it_did(uninterrupted: TrainingResult) -> None:
    history = uninterrupted.history
    assert uninterrupted.finished
    assert int(uninterrupted.state.episode) == SMALL.episodes
    assert {len(column) for column in history.values()} == {SMALL.episodes}
    assert (history["n_steps"] >= 1).all()
    assert (history["n_steps"] <= TASK.max_steps).all()
    assert history["reached"][history["n_steps"] < TASK.max_steps].all()
    assert (history["episode_return"] <= 10.0).all()
    assert not (history["episode_return"][~history["reached"]] > 0).any()
    assert uninterrupted.env_steps > history["n_steps"].sum()  # the random flights before learning count too
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(uninterrupted.state.online))


def test_equal_seeds_are_equal(place: Place, uninterrupted: TrainingResult) -> None:
    assert_same_run(train_one(SMALL, place, seed=3, chunk_rounds=4), uninterrupted)


def test_different_seeds_differ_in_parameters_actions_and_returns(
    arena: Arena, place: Place, uninterrupted: TrainingResult
) -> None:
    fresh = [initial_state(SMALL, arena, seed) for seed in (3, 4)]
    assert (weights(fresh[0].online) != weights(fresh[1].online)).all()
    other = train_one(SMALL, place, seed=4, chunk_rounds=4)
    assert (weights(other.state.online) != weights(uninterrupted.state.online)).all()
    for field in ("cell", "action", "sinr_db"):
        one, two = (np.asarray(getattr(r.state.replay.experiences.transition, field)) for r in (other, uninterrupted))
        assert (one[:100] != two[:100]).any()
    assert (other.history["episode_return"] != uninterrupted.history["episode_return"]).any()


@pytest.mark.parametrize("length", [1, 7, 30])
def test_the_length_of_chunks_changes_nothing(place: Place, uninterrupted: TrainingResult, length: int) -> None:
    assert_same_run(train_one(SMALL, place, seed=3, chunk_rounds=length), uninterrupted)


@pytest.mark.parametrize("stops", [[0], [3], [1, 2], [2, 1, 0, 2]])
def test_a_resumed_run_equals_an_uninterrupted_one(
    tmp_path: Path, place: Place, uninterrupted: TrainingResult, stops: list[int]
) -> None:
    checkpoint = tmp_path / "state.safetensors"
    for chunks in stops:
        left = iter([False] * chunks + [True])
        part = train_one(SMALL, place, 3, checkpoint=checkpoint, chunk_rounds=4, interrupted=lambda left=left: next(left))
        assert not part.finished
        assert checkpoint.is_file()
    result = train_one(SMALL, place, 3, checkpoint=checkpoint, chunk_rounds=4)
    assert result.finished
    assert_same_run(result, uninterrupted)
    again = train_one(SMALL, place, 3, checkpoint=checkpoint, chunk_rounds=4)  # nothing left to do
    assert_same_run(again, uninterrupted)


def test_checkpoints_during_training_change_nothing(tmp_path: Path, place: Place, uninterrupted: TrainingResult) -> None:
    seen: list[TrainingProgress] = []
    result = train_one(
        SMALL,
        place,
        3,
        checkpoint=tmp_path / "state.safetensors",
        chunk_rounds=4,
        checkpoint_every_s=0.0,
        progress=seen.append,
    )
    assert_same_run(result, uninterrupted)
    assert [p.done for p in seen] == [4, 8, 12, 16, 20, 24]
    assert seen[0].reached_share == pytest.approx(uninterrupted.history["reached"][:4].mean())
    assert seen[1].return_mean == pytest.approx(uninterrupted.history["episode_return"][4:8].mean())


@pytest.fixture
def interrupted(tmp_path: Path, place: Place) -> Path:
    """The checkpoint of a run that was stopped after its first chunk."""
    path = tmp_path / "state.safetensors"
    left = iter([False, True])
    train_one(SMALL, place, 3, checkpoint=path, fingerprint="this", chunk_rounds=4, interrupted=lambda: next(left))
    return path


@pytest.mark.parametrize(
    ("settings", "seed", "fingerprint"),
    [
        (SMALL, 4, "this"),
        (SMALL, 3, "another"),
        (SMALL.changed(hidden_units=9), 3, "this"),
        (SMALL.changed(hidden_layers=1), 3, "this"),
        (SMALL.changed(replay_capacity=901), 3, "this"),
        (VARIANT.changed(architecture="two-stream"), 3, "this"),
    ],
)
def test_a_checkpoint_of_other_settings_is_refused(
    place: Place, interrupted: Path, settings: DDQNHER, seed: int, fingerprint: str
) -> None:
    before = interrupted.read_bytes()
    with pytest.raises(InputError, match=r"state\.safetensors"):
        train_one(settings, place, seed, checkpoint=interrupted, fingerprint=fingerprint, chunk_rounds=4)
    assert interrupted.read_bytes() == before


def test_a_damaged_checkpoint_is_named(place: Place, interrupted: Path) -> None:
    whole = interrupted.read_bytes()
    head = whole[8:].index(b"}") + 8
    flipped = whole[:head] + b"\xff" + whole[head + 1 :]
    for content in (b"", whole[:7], whole[:100], whole[: len(whole) // 2], whole[:-1], flipped, b"\xff" * 64):
        interrupted.write_bytes(content)
        with pytest.raises(InputError, match=r"state\.safetensors"):
            train_one(SMALL, place, 3, checkpoint=interrupted, fingerprint="this", chunk_rounds=4)


@pytest.mark.parametrize("old", [b"fingerprint", b"seed", b"train_wall_s"])
def test_a_checkpoint_with_a_damaged_description_is_named(place: Place, interrupted: Path, old: bytes) -> None:
    whole = interrupted.read_bytes()
    for new in (old[:-3] + b"\\nt", old[:-1] + b"?"):  # no longer JSON; JSON without the entry
        assert whole.count(old) == 1
        interrupted.write_bytes(whole.replace(old, new))
        with pytest.raises(InputError, match=r"state\.safetensors"):
            train_one(SMALL, place, 3, checkpoint=interrupted, fingerprint="this", chunk_rounds=4)


def test_state_files_round_trip(tmp_path: Path, arena: Arena, uninterrupted: TrainingResult) -> None:
    path = tmp_path / "state.safetensors"
    identity = {"seed": 3, "fingerprint": "x"}
    save_state(path, uninterrupted.state, uninterrupted.history, identity | {"train_wall_s": 1.5})
    state, history, about = load_state(path, initial_state(SMALL, arena, 0), identity)
    assert_equal_bitwise(state, uninterrupted.state)
    assert about == identity | {"train_wall_s": 1.5}
    for name, column in uninterrupted.history.items():
        np.testing.assert_array_equal(history[name], column)
        assert history[name].dtype == column.dtype


def test_a_flight_that_outgrows_the_replay_memory_is_refused_before_training(place: Place) -> None:
    with pytest.raises(InputError, match="replay_capacity is 35"):
        train_one(SMALL.changed(replay_capacity=35, replay_start=10), place, 0)  # 12 steps x (1 + 2 hindsight goals)


def test_more_random_experiences_than_the_memory_holds_are_refused() -> None:
    """Without the check, filling the memory never ends."""
    with pytest.raises(InputError, match="replay_start"):
        SMALL.changed(replay_start=SMALL.replay_capacity + 1)


def test_a_training_that_diverges_says_so(place: Place) -> None:
    with pytest.raises(InputError, match="diverged"):
        train_one(SMALL.changed(learning_rate=1e30), place, 0, chunk_rounds=4)


@pytest.fixture(scope="module")
def filled(arena: Arena) -> LearnerState:
    """Fresh networks and the memory after the random flights; not to be donated."""
    return prepare_state(initial_state(SMALL, arena, 3), arena, jnp.int32(3), algorithm=ALGORITHM, settings=SMALL, task=TASK)


def copy(state: LearnerState) -> LearnerState:
    return jax.tree.map(jnp.copy, state)


def test_random_experiences_before_learning(arena: Arena, filled: LearnerState) -> None:
    fresh = initial_state(SMALL, arena, 3)
    assert_equal_bitwise((filled.online, filled.target), (fresh.online, fresh.target))
    per_step = 1 + SMALL.hindsight_ratio
    assert SMALL.replay_start <= int(filled.replay.size) < SMALL.replay_start + TASK.max_steps * per_step
    assert int(filled.replay.size) == int(filled.env_steps) * per_step
    assert int(filled.episode) == 0


def test_random_flights_choose_every_action_alike(arena: Arena) -> None:
    settings = VARIANT.changed(replay_capacity=60_000, replay_start=40_000, hindsight=False)
    fresh = ddqn_her_variants.initial_state(settings, arena, 0)
    bound = {"algorithm": ddqn_her_variants.ALGORITHM, "settings": settings, "task": TASK}
    state = prepare_state(fresh, arena, jnp.int32(0), **bound)
    n = int(state.replay.size)
    assert n == int(state.env_steps)
    share = np.bincount(np.asarray(state.replay.experiences.transition.action[:n]), minlength=4) / n
    np.testing.assert_allclose(share, 0.25, atol=5 * np.sqrt(0.25 * 0.75 / n))


def test_the_target_network_is_renewed_every_period_and_only_then(arena: Arena, filled: LearnerState) -> None:
    state = copy(filled)
    target = weights(state.target)
    for episode in range(1, 12):
        state, _ = train_chunk(state, arena, jnp.int32(3), jnp.int32(1), algorithm=ALGORITHM, settings=SMALL, task=TASK, length=1)
        assert int(state.episode) == episode
        assert (weights(state.online) != target).any()
        if episode % SMALL.target_period == 0:
            np.testing.assert_array_equal(weights(state.target), weights(state.online))
            target = weights(state.target)
        else:
            np.testing.assert_array_equal(weights(state.target), target)


def test_exploration_decays_over_its_share_of_the_episodes() -> None:
    settings = SMALL.changed(episodes=100, initial_exploration=2.0, final_exploration=0.1, exploration_fraction=0.5)
    for episode, value in ((0, 2.0), (10, 1.62), (25, 1.05), (50, 0.1), (99, 0.1)):
        assert float(exploration_at(settings, jnp.int32(episode))) == pytest.approx(value, abs=1e-5)


def test_progress_shows_the_exploration_of_the_episode(place: Place) -> None:
    seen: list[TrainingProgress] = []
    train_one(SMALL, place, 3, chunk_rounds=4, progress=seen.append)
    assert [p.exploration for p in seen] == pytest.approx(
        [2.0 - 1.9 * min(e / 12, 1.0) for e in (4, 8, 12, 16, 20, 24)], abs=1e-5
    )


def run_one(arena: Arena, filled: LearnerState, settings: DDQNHER) -> LearnerState:
    module = ddqn_her_variants if isinstance(settings, DDQNHERVariants) else ddqn_her
    state, _ = jax.jit(module.run_round, static_argnums=(1, 3))(jax.random.key(9), settings, arena, TASK, copy(filled))
    return state


def test_double_q_learning_changes_the_parameters(arena: Arena, filled: LearnerState) -> None:
    different_target = replace(filled, target=initial_state(SMALL, arena, 99).online)
    found = [weights(run_one(arena, different_target, settings).online) for settings in (SMALL, VARIANT.changed(double=False))]
    assert (found[0] != found[1]).any()


@pytest.mark.parametrize("k", [0, 2])
def test_hindsight_off_stores_no_relabelled_goals(arena: Arena, filled: LearnerState, k: int) -> None:
    before = int(filled.replay.size)
    state = run_one(arena, filled, VARIANT.changed(hindsight=k > 0))
    flown = int(state.env_steps) - int(filled.env_steps)
    assert int(state.replay.size) - before == flown * (1 + k)
    goals = np.asarray(state.replay.experiences.goal[before : int(state.replay.size)])
    transition = jax.tree.map(lambda ring: np.asarray(ring[before : int(state.replay.size)]), state.replay.experiences.transition)
    if k == 0:
        assert len(set(goals.tolist())) == 1
        np.testing.assert_array_equal(transition.next_cell[:-1], transition.cell[1:])  # the flight itself, in order
    else:
        assert len(set(goals.tolist())) > 1


def test_optimisation_is_adam_on_the_squared_error(arena: Arena, filled: LearnerState) -> None:
    """Two updates against the loss of equation 3.24 written out for the same mini-batches."""
    settings = SMALL.changed(updates_per_episode=2)
    state = replace(filled, target=initial_state(SMALL, arena, 99).online)
    key = jax.random.key(5)
    found = jax.jit(optimize, static_argnums=(1, 3))(key, settings, arena, TASK, state)
    row = draw_rows(key, state.replay, (2, settings.batch_size))
    batches = jax.tree.map(lambda ring: ring[row], state.replay.experiences)
    online, adam = state.online, optax.adam(settings.learning_rate)
    moments = adam.init(online)
    for i in range(2):
        transition, goal, _ = jax.tree.map(lambda field, i=i: np.asarray(field[i]), batches)
        at = lambda cells: arena.coordinates[cells]
        there = jax.vmap(state.target)(at(transition.next_cell), at(goal))
        chooser = jax.vmap(online)(at(transition.next_cell), at(goal))
        reached = transition.next_cell == goal
        reward = -0.1 + 10.0 * reached - 1.0 * (transition.sinr_db < 3.0) - 0.5 * (transition.event == STOPPED)
        target = q_learning_target(jnp.asarray(reward, jnp.float32), jnp.asarray(reached), chooser, there, TASK.discount, True)

        def loss(network: QNetwork, at=at, transition=transition, goal=goal, target=target) -> jax.Array:
            q = jax.vmap(network)(at(transition.cell), at(goal))
            return jnp.square(target - q[jnp.arange(len(goal)), transition.action]).mean()

        changes, moments = adam.update(jax.grad(loss)(online), moments)
        online = optax.apply_updates(online, changes)
    np.testing.assert_allclose(weights(found.online), weights(online), atol=1e-5)
    np.testing.assert_array_equal(weights(found.target), weights(state.target))
    assert (weights(found.online) != weights(state.online)).any()


def test_values_from_the_table_and_from_each_step_fly_alike(
    arena: Arena, filled: LearnerState, monkeypatch: pytest.MonkeyPatch
) -> None:
    def flights() -> list[np.ndarray]:
        fly = jax.jit(lambda key: collect(key, arena, TASK, filled.online, jnp.float32(0.1)))
        return [np.asarray(leaf) for seed in range(5) for leaf in jax.tree.leaves(fly(jax.random.key(seed)))]

    with_table = flights()
    monkeypatch.setattr(ddqn_episode, "MAX_TABLE_CELLS", 0)
    for one, two in zip(with_table, flights(), strict=True):
        np.testing.assert_array_equal(one, two)


def test_no_exploration_follows_the_arg_max(arena: Arena, filled: LearnerState) -> None:
    flight = jax.jit(lambda key: collect(key, arena, TASK, filled.online, jnp.float32(0.0)))(jax.random.key(0))
    n = int(flight.n_steps)
    q = jax.vmap(filled.online, (0, None))(arena.coordinates[flight.transitions.cell[:n]], arena.coordinates[flight.goal])
    np.testing.assert_array_equal(flight.transitions.action[:n], np.asarray(q).argmax(-1))


def test_clipped_targets_stay_within_what_a_flight_can_return(arena: Arena, filled: LearnerState) -> None:
    """A target network that promises far too much, or far too little, moves the online one no more than the bounds do."""
    low, high = TASK.value_bounds()
    far = 1e6
    one = jax.tree.map(jnp.zeros_like, filled.target)

    def promising(value: float) -> LearnerState:
        last = one.network.layers[-1]
        bias = jnp.full_like(last.bias, value)
        target = eqx.tree_at(lambda network: network.network.layers[-1].bias, one, bias)
        return replace(filled, target=target)

    settings = VARIANT.changed(updates_per_episode=1, clip_targets=False)
    run = jax.jit(ddqn_her_variants.optimize, static_argnums=(1, 3))
    key = jax.random.key(5)
    clipped = settings.changed(clip_targets=True)
    for value, bound in ((far, high), (-far, low)):
        found, free = (run(key, s, arena, TASK, promising(value)) for s in (clipped, settings))
        at_bound = run(key, clipped, arena, TASK, promising(4 * bound))
        moments, wild, expected = (weights(s.optimizer.mu) for s in (found, free, at_bound))
        np.testing.assert_allclose(moments, expected, rtol=1e-4, atol=1e-4)
        assert np.abs(wild).max() > 100 * np.abs(moments).max()
