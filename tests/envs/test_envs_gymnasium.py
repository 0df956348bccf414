"""The Gymnasium environments: same rules as `World` and `Task`, accepted by the checkers of Gymnasium and of SB3."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.testing import assert_array_equal

import cellpilot.gym
from cellpilot.airspace import STOPPED
from cellpilot.envs.goal_env import GoalEnv
from cellpilot.envs.vector_env import GoalVectorEnv
from cellpilot.errors import InputError
from cellpilot.experiment import build_map, make_task
from cellpilot.maps import make_map as map_of
from cellpilot.maps import save_map
from cellpilot.scenario import find_scenario, load_scenario
from cellpilot.task import Task, Transition
from cellpilot.world import World

THESIS_2D = "cellpilot/Thesis2D-v0"

MakeWorld = Callable[..., World]
TASK = Task(rho_goal=7.0, rho_sinr=-1.5, rho_step=-0.25, rho_blocked=-3.0, threshold_db=3.1, max_steps=40)


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    """A map of 4 x 3 cells with one blocked."""
    blocked = np.zeros((1, 3, 4), bool)
    blocked[0, 1, 1] = True
    radio_map = map_of(
        np.linspace(-5.0, 9.0, 12).reshape(1, 3, 4),
        x_m=np.arange(4) * 20.0,
        y_m=np.arange(3) * 20.0,
        z_m=[30.0],
        source="test",
        blocked_reason=blocked,
    )
    save_map(radio_map, tmp_path / "map.nc")
    return tmp_path / "map.nc"


NAMES = [*cellpilot.gym.SCENARIOS, cellpilot.gym.RADIO_MAP]


@pytest.fixture(params=NAMES)
def made(request: pytest.FixtureRequest, map_file: Path) -> gymnasium.Env:
    """Every registered environment, as `gymnasium.make` gives it."""
    arguments = {"map_file": map_file, "noise_std_db": 1.5} if request.param == cellpilot.gym.RADIO_MAP else {}
    return gymnasium.make(request.param, render_mode="rgb_array", **arguments)


def test_the_checker_of_gymnasium_is_content(made: gymnasium.Env) -> None:
    check_env(made.unwrapped)  # renders as well; any warning is an error here


def test_the_checker_of_sb3_is_content(made: gymnasium.Env) -> None:
    sb3 = pytest.importorskip("stable_baselines3.common.env_checker")
    sb3.check_env(made.unwrapped, skip_render_check=False)


@pytest.mark.parametrize(("name", "scenario"), cellpilot.gym.SCENARIOS.items())
def test_named_environments_are_the_shipped_scenarios(name: str, scenario: str) -> None:
    settings = load_scenario(find_scenario(scenario))
    world = World.from_map(build_map(settings.map), settings.task.noise_std_db)
    for env in (gymnasium.make(name).unwrapped, gymnasium.make_vec(name, num_envs=3)):
        assert isinstance(env, GoalEnv | GoalVectorEnv)
        assert_array_equal(env.rules.world.signal.mean_db, world.signal.mean_db)
        assert (
            env.rules.world.signal.noise_std_db == world.signal.noise_std_db == (0.0 if name == "cellpilot/Thesis2D-v0" else 2.0)
        )
        assert env.rules.world.grid.sides == ((20, 20, 5) if "3D" in name else (20, 20, 1))
        assert env.rules.task == make_task(settings.task, world.grid)
        assert env.rules.task.max_steps == (450 if "3D" in name else 400)


def test_task_settings_are_arguments(map_file: Path) -> None:
    settings = {"threshold_db": -1.0, "max_steps": 7, "start": (0, 0, 0), "goal": (3, 2, 0), "rho_blocked": -2.0}
    for env in (
        gymnasium.make("cellpilot/RadioMap-v0", map_file=str(map_file), noise_std_db=0.5, **settings).unwrapped,
        gymnasium.make_vec("cellpilot/RadioMap-v0", num_envs=2, map_file=map_file, noise_std_db=0.5, **settings),
    ):
        assert isinstance(env, GoalEnv | GoalVectorEnv)
        assert env.rules.task == Task(threshold_db=-1.0, max_steps=7, rho_blocked=-2.0)
        assert env.rules.world.signal.noise_std_db == 0.5
        observation, _ = env.reset(seed=0)
        np.testing.assert_allclose(np.atleast_2d(observation["observation"])[0], [1 / 4, 1 / 3])
        np.testing.assert_allclose(np.atleast_2d(observation["desired_goal"])[0], [1.0, 1.0])


@pytest.mark.parametrize(("sides", "share"), [((4, 3, 1), 0.3), ((3, 3, 2), 0.25), ((5, 1, 1), 0.0)])
def test_random_walks_against_plain_python(
    random_world: MakeWorld, plain: Callable, sides: tuple[int, int, int], share: float
) -> None:
    ends = set()
    for seed in range(12):
        world = random_world(seed, sides, share)
        env, reference, rng = GoalEnv(world, TASK), plain(world), np.random.default_rng(seed)
        observation, info = env.reset(seed=seed)
        here, goal = (_position(observation[key], sides) for key in ("observation", "desired_goal"))
        assert here != goal
        assert info == {}
        for n_steps in range(1, TASK.max_steps + 1):
            action = int(rng.integers(env.action_space.n))
            before = reference.cell(here)
            here, stopped = reference.step(here, action)
            observation, reward, terminated, truncated, info = env.step(np.int64(action))
            sinr_db = world.signal.mean_db[reference.cell(here)]
            assert _position(observation["observation"], sides) == _position(observation["achieved_goal"], sides) == here
            assert _position(observation["desired_goal"], sides) == goal
            assert reward == pytest.approx(-0.25 - 1.5 * (sinr_db < 3.1) - 3.0 * stopped + 7.0 * (here == goal))
            assert terminated is (here == goal)
            assert truncated is (n_steps == TASK.max_steps and here != goal)
            facts = {"sinr_db": float(sinr_db), "n_steps": n_steps, "is_success": here == goal, "action": action}
            assert info == facts | {"cell": before, "event": info["event"]}
            assert (info["event"] == STOPPED) == stopped
            if terminated or truncated:
                ends.add((terminated, truncated))
                break
    assert ends == {(True, False), (False, True)} or sides == (5, 1, 1)


def _position(coordinates: np.ndarray, sides: tuple[int, int, int]) -> tuple[int, int, int]:
    """The position behind coordinates counted from 1 and divided by the side."""
    found = [round(float(c) * n) - 1 for c, n in zip(coordinates, sides, strict=False)]
    assert all(0 <= i < n for i, n in zip(found, sides, strict=False))
    return tuple(found + [0] * (3 - len(found)))  # type: ignore[return-value]


def _fly(env: gymnasium.Env, seed: int, n: int = 300) -> tuple[list[Any], list[Any], list[Any], list[Any]]:
    """Observations, next observations, actions and (reward, terminated, truncated, info) of random steps."""
    before, after, actions, results = [], [], [], []
    rng = np.random.default_rng(seed)
    observation, _ = env.reset(seed=seed)
    for _ in range(n):
        action = rng.integers(env.action_space.n)
        following, *result = env.step(action)
        before.append(observation), after.append(following), actions.append(action), results.append(result)
        observation = env.reset()[0] if result[1] or result[2] else following
    return before, after, actions, results


@pytest.mark.parametrize(("noise", "uncertainty"), [(0.0, 0.0), (2.0, 0.0), (0.0, 3.0), (2.0, 3.0)])
def test_relabelled_rewards_are_the_outcome_of_the_recorded_facts(
    random_world: MakeWorld, noise: float, uncertainty: float
) -> None:
    world = random_world(3, (4, 4, 1), 0.2, noise, uncertainty)
    env = GoalEnv(world, TASK)
    _, after, _, results = _fly(env, 0)
    achieved, desired = (np.stack([row[key] for row in after]) for key in ("achieved_goal", "desired_goal"))
    rewards, terminated, truncated, infos = zip(*results, strict=True)
    assert len(set(rewards)) > 4
    # unchanged goals give back exactly what was received
    assert_array_equal(env.compute_reward(achieved, desired, infos), rewards)
    assert_array_equal(env.compute_terminated(achieved, desired, infos), terminated)
    assert_array_equal(env.compute_truncated(achieved, desired, infos), truncated)
    # other goals, many of them reached in that very step
    rng = np.random.default_rng(1)
    others = np.where(rng.random((len(after), 1)) < 0.5, achieved, rng.permutation(achieved))
    cell, goal = env.rules.cells(achieved), env.rules.cells(others)
    sinr_db = np.array([info["sinr_db"] for info in infos], np.float32)
    facts = Transition(None, None, cell, sinr_db, np.array([info["event"] for info in infos]))
    reward, reached, _ = TASK.outcome(facts, goal)
    assert 0 < reached.sum() < len(reached)
    assert_array_equal(env.compute_reward(achieved, others, np.array(infos, object)), reward)
    assert_array_equal(env.compute_terminated(achieved, others, infos), reached)
    as_arrays = {name: np.array([info[name] for info in infos]) for name in infos[0]}
    assert_array_equal(env.compute_reward(achieved, others, as_arrays), reward)
    one = env.compute_reward(achieved[0], others[0], infos[0])
    assert np.shape(one) == ()
    assert one == reward[0]


def test_without_facts_the_map_is_looked_up_or_it_is_refused(random_world: MakeWorld) -> None:
    silent = Task(rho_blocked=0.0, max_steps=40)
    for world, task in ((random_world(3, (4, 4, 1)), TASK), (random_world(3, (4, 4, 1), 0.2), silent)):
        env = GoalEnv(world, task)
        _, after, _, results = _fly(env, 0)
        achieved, desired = (np.stack([row[key] for row in after]) for key in ("achieved_goal", "desired_goal"))
        assert_array_equal(env.compute_reward(achieved, desired, [{}] * len(after)), [row[0] for row in results])
    refused = [
        (random_world(3, (4, 4, 1), noise_std_db=1.0), silent),
        (random_world(3, (4, 4, 1), sinr_std_db=1.0), silent),
        (random_world(3, (4, 4, 1), 0.2), TASK),
    ]
    for world, task in refused:
        env = GoalEnv(world, task)
        observation, _ = env.reset(seed=0)
        with pytest.raises(InputError, match="copy_info_dict"):
            env.compute_reward(observation["achieved_goal"], observation["desired_goal"], {})


@pytest.mark.parametrize("uncertainty", [0.0, 2.0])
def test_hindsight_buffer_of_sb3_relabels_with_what_was_measured(random_world: MakeWorld, uncertainty: float) -> None:
    """Noise differs from step to step, so a reward looked up, or taken from another step, is found out."""
    sb3 = pytest.importorskip("stable_baselines3")
    world = random_world(5, (4, 3, 1), 0.1, noise_std_db=4.0, sinr_std_db=uncertainty)
    flights = sb3.common.vec_env.DummyVecEnv([lambda: GoalEnv(world, TASK)] * 2)
    spaces = flights.observation_space, flights.action_space
    buffer = sb3.HerReplayBuffer(400, *spaces, flights, device="cpu", n_envs=2, n_sampled_goal=4, copy_info_dict=True)
    flights.seed(0)
    observation, rng, measured = flights.reset(), np.random.default_rng(0), []
    for _ in range(170):
        actions = rng.integers(4, size=2)
        after, rewards, over, infos = flights.step(actions)
        following = {key: rows.copy() for key, rows in after.items()}
        for i in np.flatnonzero(over):
            for key, rows in following.items():
                rows[i] = infos[i]["terminal_observation"][key]
        measured.append([(info["sinr_db"], info["event"]) for info in infos])
        buffer.add(observation, following, actions, rewards, over, infos)
        observation = after
    step, flight = np.nonzero(buffer.ep_length)
    sample = buffer._get_virtual_samples(step, flight)
    rules = flights.envs[0].rules
    cell, goal = (rules.cells(sample.next_observations[key].numpy()) for key in ("achieved_goal", "desired_goal"))
    sinr_db, event = np.array(measured)[step, flight].T
    facts = Transition(None, None, cell, sinr_db.astype(np.float32), event)
    reward, reached, _ = TASK.outcome(facts, goal)
    assert 50 < reached.sum() < len(goal)
    assert (event == STOPPED).any()
    np.testing.assert_allclose(sample.rewards.numpy()[:, 0], reward, rtol=1e-6)
    looked_up = TASK.outcome(facts._replace(sinr_db=world.signal.mean_db[cell]), goal)[0]
    assert (abs(looked_up - reward) > 1).mean() > 0.1


def test_seeds(made: gymnasium.Env) -> None:
    first, again, other = (_fly(made, seed, 60) for seed in (1, 1, 2))
    as_text = lambda flight: [repr(column) for column in (flight[0], flight[1], flight[3])]
    assert as_text(first) == as_text(again)
    assert all(a != b for a, b in zip(as_text(first), as_text(other), strict=True))
    starts = {repr(made.reset(seed=seed)[0]) for seed in range(20)}
    assert len(starts) > 15


def test_noise_is_drawn_at_every_step_and_the_map_once_per_flight(make_world: MakeWorld) -> None:
    task = Task(max_steps=3000)
    noisy = GoalEnv(make_world((2, 2, 1), 5.0, noise_std_db=2.0), task, start=(0, 0, 0), goal=(1, 1, 0))
    noisy.reset(seed=0)
    sinr_db = np.array([noisy.step(np.int64(1))[4]["sinr_db"] for _ in range(3000)])
    assert sinr_db.mean() == pytest.approx(5.0, abs=5 * 2 / np.sqrt(3000))
    assert sinr_db.std() == pytest.approx(2.0, rel=0.1)
    unsure = GoalEnv(make_world((2, 2, 1), 5.0, sinr_std_db=2.0), task, start=(0, 0, 0), goal=(1, 1, 0))
    flights = []
    for seed in range(200):
        unsure.reset(seed=seed)
        flights.append([unsure.step(np.int64(1))[4]["sinr_db"] for _ in range(3)])
    assert np.ptp(flights, axis=1).max() == 0
    assert np.std(flights) == pytest.approx(2.0, rel=0.2)


def test_places_can_be_given_for_one_flight(make_world: MakeWorld) -> None:
    env = GoalEnv(make_world((4, 3, 1), blocked=[(1, 1, 0)]), TASK)
    observation, _ = env.reset(seed=0, options={"start": (3, 2, 0), "goal": np.array([0, 1, 0])})
    assert _position(observation["observation"], (4, 3, 1)) == (3, 2, 0)
    assert _position(observation["desired_goal"], (4, 3, 1)) == (0, 1, 0)
    assert len({repr(env.reset()[0]) for _ in range(20)}) > 10
    for options, named in (
        ({"start": (1, 1, 0)}, r"start \(1, 1, 0\) lies in a blocked cell \(marked in the map\)"),
        ({"goal": (4, 0, 0)}, r"goal \(4, 0, 0\) is not on the grid"),
        ({"goal": (0, 0)}, r"\(0, 0\) is no position"),
        ({"goal": "here"}, "'here' is no position"),
        ({"end": (0, 0, 0)}, "unknown option 'end'"),
    ):
        with pytest.raises(InputError, match=named):
            env.reset(options=options)


def test_pictures_show_the_flight(made: gymnasium.Env) -> None:
    made.reset(seed=0)
    first = made.render()
    assert isinstance(first, np.ndarray)
    assert first.shape == (416, 448, 3)
    made.step(made.action_space.sample())
    assert (made.render() != first).any()
    assert gymnasium.make("cellpilot/Thesis2D-v0").unwrapped.render() is None


def _vector(world: World, **options: Any) -> GoalVectorEnv:
    return GoalVectorEnv(world, TASK, 7, **options)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
@pytest.mark.parametrize(("noise", "uncertainty"), [(0.0, 0.0), (2.0, 3.0)])
def test_many_flights_follow_the_rules_of_one(
    random_world: MakeWorld, plain: Callable, mode: str, noise: float, uncertainty: float
) -> None:
    world = random_world(1, (3, 3, 2), 0.2, noise, uncertainty)
    env, reference, rng = _vector(world, autoreset_mode=mode), plain(world), np.random.default_rng(0)
    sides = world.grid.sides
    observation, _ = env.reset(seed=4)
    begun = [0] * 7
    over, ended = np.zeros(7, bool), 0
    for _ in range(300):
        if mode == "Disabled" and over.any():
            kept = {key: rows.copy() for key, rows in observation.items()}
            observation, _ = env.reset(options={"reset_mask": over})
            for key, rows in observation.items():
                assert_array_equal(rows[~over], kept[key][~over])
            begun = [0 if o else n for o, n in zip(over, begun, strict=True)]
        actions = rng.integers(6, size=7)
        after, reward, terminated, truncated, info = env.step(actions)
        assert env.observation_space.contains(after)
        for i in range(7):
            if mode == "NextStep" and over[i]:
                assert (reward[i], terminated[i], truncated[i], info["_sinr_db"][i]) == (0.0, False, False, False)
                assert (after["observation"][i] != after["desired_goal"][i]).any()
                begun[i] = 0
                continue
            here, goal = (_position(observation[key][i], sides) for key in ("observation", "desired_goal"))
            there, stopped = reference.step(here, int(actions[i]))
            begun[i] += 1
            low = info["sinr_db"][i] < np.float32(3.1)
            assert reward[i] == pytest.approx(-0.25 - 1.5 * low - 3.0 * stopped + 7.0 * (there == goal))
            assert terminated[i] == info["is_success"][i] == (there == goal)
            assert truncated[i] == (begun[i] == TASK.max_steps and there != goal)
            assert (info["n_steps"][i], info["event"][i] == STOPPED, info["_sinr_db"][i]) == (begun[i], stopped, True)
            if not noise and not uncertainty:
                assert info["sinr_db"][i] == world.signal.mean_db[reference.cell(there)]
            last = {key: rows[i] for key, rows in after.items()}
            if mode == "SameStep" and (terminated[i] or truncated[i]):
                last = info["final_obs"][i]
                assert info["_final_obs"][i]
                assert info["final_info"]["sinr_db"][i] == info["sinr_db"][i]
                assert (after["observation"][i] != after["desired_goal"][i]).any()
                begun[i] = 0
            assert _position(last["observation"], sides) == _position(last["achieved_goal"], sides) == there
            assert _position(last["desired_goal"], sides) == goal
        counts = info["_sinr_db"] & ~(terminated | truncated)
        relabelled = env.compute_reward(after["achieved_goal"], after["desired_goal"], info)
        assert_array_equal(relabelled[counts], reward[counts])
        assert_array_equal(env.compute_terminated(after["achieved_goal"], after["desired_goal"], info)[counts], False)
        assert_array_equal(env.compute_truncated(after["achieved_goal"], after["desired_goal"], info)[counts], False)
        observation, over = after, terminated | truncated
        ended += over.sum()
    assert ended > 20


def test_many_flights_keep_what_they_handed_out_and_follow_their_seed(random_world: MakeWorld) -> None:
    world = random_world(1, (3, 3, 2), 0.2, 2.0, 3.0)
    runs = []
    for seed in (0, 0, 1):
        env, rng = _vector(world), np.random.default_rng(5)
        seen = [env.reset(seed=seed), *(env.step(rng.integers(6, size=7)) for _ in range(60))]
        runs.append([repr(step) for step in seen])
        env.step(rng.integers(6, size=7))
        assert [repr(step) for step in seen] == runs[-1]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_gymnasium_makes_many_flights_in_each_of_its_ways(map_file: Path) -> None:
    for mode in ("sync", "vector_entry_point", None):
        env = gymnasium.make_vec("cellpilot/RadioMap-v0", num_envs=3, vectorization_mode=mode, map_file=map_file)
        assert isinstance(env, GoalVectorEnv) is (mode != "sync")
        wrapped = gymnasium.wrappers.vector.RecordEpisodeStatistics(env)
        wrapped.reset(seed=0)
        returns = []
        for _ in range(400):
            _, _, _, _, info = wrapped.step(wrapped.action_space.sample())
            returns += list(info["episode"]["r"][info["_episode"]]) if "episode" in info else []
        assert len(returns) > 3
    same = gymnasium.make_vec("cellpilot/RadioMap-v0", num_envs=3, map_file=map_file, autoreset_mode="SameStep")
    assert same.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.SAME_STEP


def test_importing_the_module_by_its_name_registers() -> None:
    """In a fresh interpreter: the id names the module, nothing of JAX is loaded, a plain `import cellpilot` stays light."""
    code = """
import sys, gymnasium, cellpilot
assert "cellpilot.gym" not in sys.modules
env = gymnasium.make("cellpilot.gym:cellpilot/Thesis2D-v0")
env.reset(seed=0)
assert gymnasium.make("cellpilot/Thesis2D-v0").unwrapped.rules.task == env.unwrapped.rules.task
assert not {"jax", "equinox", "torch", "matplotlib.pyplot"} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


def test_importing_the_package_does_not_import_gymnasium() -> None:
    subprocess.run([sys.executable, "-c", "import sys, cellpilot; assert 'gymnasium' not in sys.modules"], check=True)


def test_without_gymnasium_the_extra_is_named() -> None:
    code = "import sys; sys.modules['gymnasium'] = None; import cellpilot.gym"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.splitlines()[-1] == "ImportError: the environments need Gymnasium: pip install 'cellpilot[gym]'"


def test_unknown_names_are_gymnasiums_error() -> None:
    for make in (gymnasium.make, gymnasium.make_vec):
        with pytest.raises(gymnasium.error.NameNotFound, match=r"Thesis4D.*in namespace cellpilot. Did you mean: `Thesis"):
            make("cellpilot/Thesis4D-v0")
        with pytest.raises(gymnasium.error.VersionNotFound, match="`v3` for environment `cellpilot/Thesis2D` doesn't exist"):
            make("cellpilot/Thesis2D-v3")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({}, ["map_file", "RadioMap-v0"]),
        ({"map_file": "gone.nc"}, ["gone.nc", "no such file"]),
        ({"map_file": "empty.nc"}, ["empty.nc", "empty"]),
        ({"map_file": "text.nc"}, ["text.nc", "NetCDF"]),
        ({"threshold": 3.0}, ["threshold"]),
        ({"max_steps": 0}, ["max_steps", "0"]),
        ({"noise_std_db": -1.0}, ["noise_std_db", "-1"]),
        ({"discount": 1.5}, ["discount", "1.5"]),
        ({"rho_goal": float("nan")}, ["rho_goal", "nan"]),
        ({"start": (9, 0, 0)}, ["start", "(9, 0, 0)"]),
        ({"goal": (1, 1, 0)}, ["goal", "(1, 1, 0)", "blocked"]),
        ({"start": (0, 0, 0), "goal": (0, 0, 0)}, ["start", "goal"]),
    ],
)
def test_wrong_arguments_are_one_line(
    map_file: Path, monkeypatch: pytest.MonkeyPatch, arguments: dict[str, Any], named: list[str]
) -> None:
    monkeypatch.chdir(map_file.parent)
    Path("empty.nc").touch()
    Path("text.nc").write_text("this is no map\n")
    if "map_file" not in named:
        arguments = {"map_file": "map.nc"} | arguments
    for make in (gymnasium.make, gymnasium.make_vec):
        with pytest.raises(InputError) as caught:
            make("cellpilot/RadioMap-v0", **arguments)
        assert "\n" not in str(caught.value)
        for name in named:
            assert name in str(caught.value)


def test_wrong_calls_are_refused(make_world: MakeWorld) -> None:
    world = make_world((3, 2, 1))
    env, flights = GoalEnv(world, TASK), _vector(world)
    for call in (lambda: env.step(np.int64(0)), lambda: flights.step(np.zeros(7, int))):
        with pytest.raises(gymnasium.error.ResetNeeded):
            call()
    env.reset(seed=0)
    flights.reset(seed=0)
    for call, named in (
        (lambda: env.step(np.int64(4)), "action is 4; expected 0 to 3"),
        (lambda: env.step(np.int64(-1)), "action is -1"),
        (lambda: flights.step(np.full(7, 4)), "expected 0 to 3"),
        (lambda: flights.step(np.zeros(6, int)), r"shape \(6,\)"),
        (lambda: flights.step(np.zeros(7)), "float64"),
        (lambda: flights.reset(options={"reset_mask": [True]}), "reset_mask"),
        (lambda: env.compute_truncated(np.ones(2), np.ones(2), {}), "n_steps"),
        (lambda: GoalEnv(world, TASK, render_mode="ansi"), "render_mode is 'ansi'"),
        (lambda: _vector(world, render_mode="rgb_array"), "render_mode"),
        (lambda: _vector(world, autoreset_mode="Later"), "Later.*NextStep"),
        (lambda: GoalVectorEnv(world, TASK, 0), "num_envs is 0"),
    ):
        with pytest.raises(InputError, match=named):
            call()
    disabled = _vector(world, autoreset_mode="Disabled", start=(0, 0, 0), goal=(1, 0, 0))
    disabled.reset(seed=0)
    disabled.step(np.full(7, 2))
    with pytest.raises(InputError, match="reset_mask"):
        disabled.step(np.full(7, 2))


def test_goals_drawn_from_the_space_lie_in_cells_and_others_are_refused() -> None:
    env = gymnasium.make(THESIS_2D).unwrapped
    space = env.observation_space["desired_goal"]
    space.seed(0)
    for _ in range(500):
        cell = env.rules.cells(space.sample())
        assert 0 <= cell < 400
    for corner, cell in (([0.05, 0.05], 0), ([1.0, 0.05], 19), ([0.05, 1.0], 380), ([1.0, 1.0], 399)):
        assert env.rules.cells(np.array(corner, np.float32)) == cell
    # Half a cell below the first, this goal once counted as reached at the opposite border.
    achieved = np.array([1.0, 0.05], np.float32)
    for goal in ([0.0, 0.1], [0.02, 0.5], [1.03, 0.5], [np.nan, 0.5], [0.5, -1.0]):
        with pytest.raises(InputError, match="lies in no cell"):
            env.compute_reward(achieved, np.array(goal), {})
    with pytest.raises(InputError, match="expected 2 coordinates"):
        env.compute_reward(achieved, np.zeros(3), {})


def test_no_info_is_as_an_empty_one() -> None:
    env = gymnasium.make(THESIS_2D).unwrapped
    here, there = np.array([0.5, 0.5], np.float32), np.array([[0.5, 0.5], [0.1, 0.1]], np.float32)
    assert env.compute_reward(here, here, None) == env.compute_reward(here, here, {})
    rows = np.stack([here, here])
    expected = env.compute_reward(rows, there, [{}, {}])
    for info in (None, [None, None], np.array([None, None]), np.array([{}, {}])):
        np.testing.assert_array_equal(env.compute_reward(rows, there, info), expected)
    noisy = gymnasium.make("cellpilot/Thesis2DNoise-v0").unwrapped
    with pytest.raises(InputError, match="info holds no cell, action, sinr_db and event"):
        noisy.compute_reward(here, here, None)


def test_many_flights_take_gymnasiums_own_cap_on_steps() -> None:
    many = gymnasium.make_vec(THESIS_2D, num_envs=2, max_episode_steps=5, start=(0, 0, 0), goal=(19, 19, 0))
    many.reset(seed=0)
    ended = [many.step(np.zeros(2, np.int64))[3].all() for _ in range(5)]
    assert ended == [False] * 4 + [True]
    assert gymnasium.make_vec(THESIS_2D, max_episode_steps=10_000).rules.task.max_steps == 400


@pytest.mark.parametrize("place", [np.array([3, 4, 0]), (np.int64(3), np.int32(4), np.uint8(0)), [3, 4, 0], (3, 4, 0)])
def test_starts_and_goals_may_be_any_whole_numbers(place: object) -> None:
    env = gymnasium.make(THESIS_2D, start=place, goal=(9, 9, 0)).unwrapped
    observation, _ = env.reset(seed=0)
    np.testing.assert_allclose(observation["observation"], [4 / 20, 5 / 20])
    again, _ = env.reset(options={"start": place})
    np.testing.assert_array_equal(observation["observation"], again["observation"])


def test_a_place_of_other_than_three_whole_numbers_is_refused() -> None:
    for place in ((1.5, 2, 0), "12", (1, 2), 7):
        with pytest.raises(InputError, match="is no position; expected three whole numbers"):
            gymnasium.make(THESIS_2D, start=place)


def test_actions_are_single_whole_numbers() -> None:
    env = gymnasium.make(THESIS_2D).unwrapped
    env.reset(seed=0)
    for action in (1, np.int64(1), np.array(1), np.uint8(1)):
        env.step(action)
    for action in (np.array([1]), 1.0, "1", None, np.array([0, 1]), -1, 4):
        with pytest.raises(InputError, match=r"action is .*; expected"):
            env.step(action)
