"""The learners under each rule for forbidden moves: what is not offered is not taken, what ends a flight is not sought."""

from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cellpilot.envs.arena import make_arena
from cellpilot.envs.flight import Flight, fly
from cellpilot.evaluate import evaluate_policies
from cellpilot.evaluate.exact import fly_all
from cellpilot.evaluate.instances import all_pairs
from cellpilot.grid import Grid
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER, DDQNHERVariants
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.learn.hindsight import hindsight_goals
from cellpilot.learn.learner import Place
from cellpilot.learn.trainer import train_one
from cellpilot.policies import GreedyPolicy, LearnedPolicy, OptimalPolicy, PolicyParameters, load_parameters
from cellpilot.policies.learned import save_parameters
from cellpilot.policies.onnx_file import save_onnx
from cellpilot.task import Price, Task
from cellpilot.world import World

MakeWorld = Callable[..., World]
TASK = Task(max_steps=60, rho_blocked=-0.5, rho_end=-3.0)
FQI = FQIHER(rounds=60, flights=16, steps_per_round=12, updates_per_round=15, batch_size=256, goals_per_round=25, hidden_units=32)
DDQN = DDQNHERVariants(
    episodes=1500, replay_capacity=20_000, replay_start=1_000, updates_per_episode=20, hidden_layers=2, hidden_units=64
)
GRID = Grid((0.0, 20.0), (0.0, 20.0), (30.0,))
RULES = [("stay", 4), ("mask", 4), ("end", 4), ("end", 8)]


def learned(world: World, settings: FQIHER | DDQNHER) -> PolicyParameters:
    about = {"task": TASK.as_dict()}
    result = train_one(settings, Place(world, TASK), 0)
    return result.policy_parameters(about).trained_in(world.airspace)


@pytest.mark.parametrize(("rule", "n_moves"), RULES)
def test_fqi_her_learns_under_every_rule(random_world: MakeWorld, rule: str, n_moves: int) -> None:
    world = random_world(31, (5, 5, 1), 0.2, rule=rule, n_moves=n_moves)
    parameters = learned(world, FQI)
    parameters.check_airspace(world.airspace)
    policy = LearnedPolicy(parameters, world.grid)
    result = evaluate_policies(world, TASK, [GreedyPolicy(world), OptimalPolicy(world, TASK), policy], seed=0, n_sampled=10)
    assert result.policies["learned/argmax"]["reached_share"] == 1
    assert result.policies["learned/argmax"]["score"] > 0.95


@pytest.mark.parametrize(("rule", "n_moves"), RULES[1:3])
@pytest.mark.parametrize("double", [True, False])
def test_ddqn_her_learns_under_the_new_rules(make_world: MakeWorld, rule: str, n_moves: int, double: bool) -> None:
    world = make_world((4, 4, 1), blocked=[(1, 1, 0), (2, 3, 0)], rule=rule, n_moves=n_moves)
    parameters = learned(world, DDQN.changed(double=double))
    probabilities = LearnedPolicy(parameters, world.grid, 0.5).action_probabilities(world.airspace.free_cells)
    np.testing.assert_allclose(probabilities.sum(-1), 1, rtol=1e-5)
    if rule == "mask":
        assert not probabilities[~world.airspace.offered[:, None, :].repeat(probabilities.shape[1], 1)].any()
    goals = world.airspace.free_cells
    starts, goal = all_pairs(world, goals)
    departures = np.zeros((world.grid.n_cells, len(goals)))
    departures[starts, np.searchsorted(goals, goal)] = 1.0
    actions = LearnedPolicy(parameters, world.grid).action_probabilities(goals).argmax(-1)
    n_steps, reached, _ = fly_all(world, TASK, actions, goals, departures)
    lost = (departures > 0) & ~reached
    ended_in_a_blocked_cell = lost & (n_steps < TASK.max_steps)
    assert ended_in_a_blocked_cell.sum() < 0.03 * departures.sum()
    assert lost.sum() < 0.6 * departures.sum()


@pytest.mark.parametrize("strategy", ["future", "final", "episode"])
def test_hindsight_never_draws_a_forbidden_cell(random_world: MakeWorld, strategy: str) -> None:
    world = random_world(31, (4, 4, 1), 0.3, rule="end")
    arena, ended = make_arena(world), 0
    start, goal = world.airspace.free_cells[[0, -1]]

    @jax.jit
    def drawn(seed: jax.Array) -> tuple[Flight, jax.Array]:
        actions = jax.random.randint(jax.random.key(seed), (60,), 0, 4)
        flight = fly(jax.random.key(0), arena, TASK, jnp.int32(start), jnp.int32(goal), lambda cell, t: actions[t])
        return flight, hindsight_goals(jax.random.key(seed), flight, 4, strategy, ends=True)

    for seed in range(60):
        flight, goals = drawn(jnp.int32(seed))
        assert not world.airspace.blocked[np.asarray(goals)[: int(flight.n_steps)]].any()
        ended += bool(flight.terminated & ~flight.reached)
    assert ended > 20


def test_a_policy_refuses_other_moves_and_another_rule(random_world: MakeWorld) -> None:
    world = random_world(31, (4, 4, 1), 0.2)
    parameters = learned(world, DDQN.changed(episodes=2))
    for other, message in (({"n_moves": 8}, "4 moves, not 8"), ({"rule": "mask"}, "'stay' for forbidden moves, not 'mask'")):
        with pytest.raises(ValueError, match=message):
            parameters.check_airspace(random_world(31, (4, 4, 1), 0.2, **other).airspace)


@pytest.mark.parametrize("settings", [FQI.changed(rounds=5), DDQN.changed(episodes=20)], ids=["fqi-her", "ddqn-her"])
@pytest.mark.parametrize(("rule", "n_moves"), RULES[1:])
def test_an_exported_policy_follows_the_rule(
    random_world: MakeWorld, tmp_path: Path, rule: str, n_moves: int, settings: FQIHER | DDQNHER
) -> None:
    import onnxruntime

    world = random_world(31, (4, 4, 1), 0.2, rule=rule, n_moves=n_moves)
    save_parameters(learned(world, settings), tmp_path / "policy.safetensors")
    parameters = load_parameters(tmp_path / "policy.safetensors")
    save_onnx(parameters, tmp_path / "policy.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx")
    goal = int(world.airspace.free_cells[-1])
    cells = world.airspace.free_cells[:-1]
    position = {"position": cells, "goal": np.full(len(cells), goal)}
    values, action = session.run(None, {name: world.grid.position(at).astype(np.int64) for name, at in position.items()})
    expected = parameters.values(world.grid, np.array([goal]))[cells, 0]
    np.testing.assert_allclose(values, expected, atol=1e-4)
    np.testing.assert_array_equal(np.isneginf(values), ~world.airspace.offered[cells])
    assert world.airspace.offered[cells, action].all()


def test_fqi_her_refuses_a_reward_that_its_policy_cannot_carry() -> None:
    with pytest.raises(ValueError, match="'climb'"):
        FQI.check_fits(Task(more=(Price("climb", -1.0, "move", lambda move: move.action == 4),)), GRID)
