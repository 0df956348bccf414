"""The benchmark's own facts: its Gymnasium environment flies the same task, its arithmetic and its report are right."""

from pathlib import Path

import numpy as np
import pytest

from cellpilot.task import Transition


@pytest.fixture(autouse=True)
def _benchmarks_on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "benchmarks"))


def test_flop_of_one_update_by_hand():
    from ours import flop_per_update

    # layers 2-3-1, batch 1: products of 12 and 6 FLOP; three forward, weight gradients, one input gradient
    assert flop_per_update((2, 3, 1), 1) == 3 * 18 + 18 + 6


def test_report_takes_ratios_within_a_repeat_and_labels_extrapolation():
    import report

    repeats = [dict.fromkeys(report.QUANTITIES, 1.0) | {"sb3_total_s": 20.0, "ours_total_s": 2.0}]
    repeats.append(dict.fromkeys(report.QUANTITIES, 1.0) | {"sb3_total_s": 90.0, "ours_total_s": 3.0})
    summary = report.summarise(repeats)
    assert summary["training_sb3_over_ours"] == {"median": 20.0, "min": 10.0, "max": 30.0}
    results = {
        "command": "c", "date": "d", "minutes": 1.0, "versions": {"jax": "1"}, "repeats": 2, "episodes": 10, "episodes_whole": 20,
        "extrapolated": True, "updates": 600, "torch_threads": 1, "flop_per_update": 24, "summary": summary,
        "machine": {"cpu": "x", "cores": 2, "system": "Linux", "load_before": 0.1, "load_highest": 1.2},
    }  # fmt: skip
    text = report.markdown(results)
    assert "EXTRAPOLATED from the first 10 of 20" in text
    assert "| whole training: SB3 / cellpilot | 20.0 | 10.0 - 30.0 | x |" in text
    assert "BUSY" not in text
    results["machine"]["load_before"] = 3.0
    assert "BUSY" in report.markdown(results)
    assert "EXTRAPOLATED" not in report.markdown(results | {"extrapolated": False})


def test_goal_flight_agrees_with_world_and_task():
    from goal_flight import GoalFlight
    from gymnasium.utils.env_checker import check_env
    from ours import thesis_case

    case = thesis_case()
    world, task = case.world, case.task
    env = GoalFlight(world, task)
    check_env(env, skip_render_check=True)
    rng = np.random.default_rng(1)
    reached = 0
    for episode in range(30):
        observation, _ = env.reset(seed=episode)
        cell, goal, ended, n_steps = env.cell, env.goal, False, 0
        assert cell != goal
        while not ended:
            action = rng.integers(4)
            next_cell = world.airspace.next_cell[cell, action]
            facts = Transition(cell, action, next_cell, world.signal.mean_db[next_cell], world.airspace.event[cell, action])
            expected_reward, _, expected_terminated = task.outcome(facts, goal)
            observation, reward, terminated, truncated, _ = env.step(action)
            n_steps += 1
            assert reward == pytest.approx(expected_reward)
            assert terminated == expected_terminated
            assert truncated == (n_steps == task.max_steps and not terminated)
            np.testing.assert_array_equal(observation["achieved_goal"], np.asarray(case.arena.coordinates)[next_cell])
            cell, ended = next_cell, terminated or truncated
        reached += bool(terminated)
    assert 0 < reached < 30
    entered, goals = rng.integers(world.grid.n_cells, size=(2, 500))
    goals[:50] = entered[:50]
    facts = Transition(entered, None, entered, world.signal.mean_db[entered], np.zeros(500, np.uint8))
    rewards = env.compute_reward(env.coordinates[entered], env.coordinates[goals], [{}] * 500)
    np.testing.assert_allclose(rewards, task.outcome(facts, goals)[0])


def test_scaling_keeps_the_map_and_scores_what_was_trained():
    from argparse import Namespace

    import scaling

    learner = scaling.Learner("thesis-2d", 2)
    small, large = (scaling.make_case(learner, side) for side in (10, 20))
    assert large.world.grid.sides[:2] == (20, 20)
    coarse = np.asarray(large.world.signal.mean_db).reshape(10, 2, 10, 2).mean((1, 3)).ravel()
    np.testing.assert_allclose(coarse, small.world.signal.mean_db, atol=0.01)  # the same points, averaged over other cells
    budget = Namespace(time_budget=0.0, quality_budget=0.0)
    point = scaling.quality_point(learner, 10, 1, budget)
    assert point["share_trained"] == 0
    assert point["goals"] == 100
    assert point["reached_share"] < 0.5  # an untrained network leads nowhere
    point = scaling.time_point(learner, 10, 2, Namespace(time_budget=30.0, quality_budget=0.0))
    assert point["rounds_timed"] == scaling.CHUNKS * 2
    assert point["whole_s"] > point["compile_s"]
    name = {"kind": "time", "learner": "ddqn-her", "side": 10, "seeds": 2}
    assert "| ddqn-her | 10 | 100 | 2 |" in scaling.time_row(name | point)
    assert "too long" in scaling.time_row(name | {"failed": "too long"})


@pytest.mark.slow
def test_finer_grids_shows_both_learners(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    import finer_grids

    few = ["--side", "10", "--rounds", "2", "--look-ahead", "1", "3", "--flights", "2", "4"]
    monkeypatch.setattr("sys.argv", ["finer_grids.py", *few])
    monkeypatch.setattr(finer_grids, "console", finer_grids.Console(soft_wrap=True, highlight=False))
    finer_grids.main()
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(", ")[0] for line in lines] == ["seed 0: FQI-HER"] * 2 + ["seed 0: map learner"] * 2
    assert "looks 3 ahead" in lines[1]
    assert lines[1].split("score")[1] != lines[0].split("score")[1]  # looking ahead changes the policy of two rounds
    assert all("reached 100.00%" in line for line in lines[2:])


def test_simulation_tells_size_time_and_memory(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    import simulation

    found = simulation.point(0.0)
    assert (found["cells"], found["sites"]) == (2000, 7)
    assert 0.01 < found["peak_gb"] < 100
    monkeypatch.setattr("sys.argv", ["simulation.py", "--sides-m", "2500", "--repeats", "1"])
    simulation.main()
    told = capsys.readouterr().out
    assert "2.5 km x 2.5 km, one point a cell: 78,125 cells, 37 sites" in told


def test_three_maps_shows_greedy_optimum_and_learners(capsys: pytest.CaptureFixture[str]) -> None:
    import three_maps

    from cellpilot.experiment import build_map
    from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
    from cellpilot.scenario import Scenario, SimulatedMap
    from cellpilot.world import World

    learner = FQIHER(rounds=3, flights=8, updates_per_round=2, goals_per_round=4, cached_goals=16)
    scenario = Scenario(learner=learner)
    world = World.from_map(build_map(SimulatedMap(bin_m=100.0, points_per_side=2)))
    three_maps.show("small", scenario, {"hasty": scenario}, world, 2)
    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines()]
    assert [row[3].split(",")[0] for row in rows] == ["greedy", "optimum", "hasty"]
    assert [row[-1].strip(" |") for row in rows[:2]] == ["0.000", "1.000"]
    assert "(" in rows[2][-1]  # least to greatest of two seeds


def test_the_network_that_is_timed_is_the_thesis_one():
    from ours import thesis_case

    assert thesis_case().layer_sizes == (4, 50, 50, 50, 4)
    assert thesis_case().updates == 900_000
