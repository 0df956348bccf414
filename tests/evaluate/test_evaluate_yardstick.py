"""The deterministic default map against figures that another program computed (docs: the yardstick)."""

from functools import cache

import pytest

from cellpilot.evaluate import evaluate_policies
from cellpilot.experiment import build_map, make_policies, make_task
from cellpilot.scenario import RewardSettings, SimulatedMap
from cellpilot.world import World

HEIGHTS_3D_M = (20.0, 40.0, 60.0, 80.0, 100.0)


@cache
def figures(heights_m: tuple[float, ...], noise_std_db: float, names: tuple[str, ...]) -> dict[str, dict[str, float]]:
    world = World.from_map(build_map(SimulatedMap(heights_m=heights_m)), noise_std_db)
    task = make_task(RewardSettings(noise_std_db=noise_std_db), world.grid)
    policies = [policy for policy in make_policies(world, task, 0.1, None) if policy.name in names]
    return evaluate_policies(world, task, policies, seed=0, n_sampled=10).policies


def check(row: dict[str, float], expected: tuple[float, float, float, float]) -> None:
    """Return, steps below 3 dB [%], path ratio p50 and p90; everybody arrives."""
    assert row["reached_share"] == pytest.approx(1.0, abs=1e-9)
    assert row["return_mean"] == pytest.approx(expected[0], abs=0.005)
    assert 100 * row["low_sinr_share"] == pytest.approx(expected[1], abs=0.1)
    assert row["path_ratio_p50"] == pytest.approx(expected[2], abs=0.01)
    assert row["path_ratio_p90"] == pytest.approx(expected[3], abs=0.01)


ALL = ("greedy", "optimal", "optimal-undiscounted")


@pytest.mark.parametrize(
    ("policy", "expected"),
    [
        ("greedy", (7.132, 11.51, 1.0, 1.0)),
        ("optimal", (8.130, 3.42, 1.0, 1.18)),
        ("optimal-undiscounted", (8.130, 3.38, 1.0, 1.20)),
    ],
)
def test_one_height(policy: str, expected: tuple[float, float, float, float]) -> None:
    check(figures((30.0,), 0.0, ALL)[policy], expected)


@pytest.mark.parametrize(
    ("policy", "expected"),
    [
        ("greedy", (6.993, 12.55, 1.0, 1.0)),
        ("optimal", (7.899, 4.85, 1.0, 1.24)),
        ("optimal-undiscounted", (7.909, 4.39, 1.0, 1.40)),
    ],
)
def test_one_height_with_noise(policy: str, expected: tuple[float, float, float, float]) -> None:
    check(figures((30.0,), 2.0, ALL)[policy], expected)


@pytest.mark.slow
@pytest.mark.parametrize(("policy", "expected"), [("greedy", (-2.468, 73.63, 1.0, 1.0)), ("optimal", (4.844, 18.75, 1.15, 1.57))])
def test_five_heights_with_noise(policy: str, expected: tuple[float, float, float, float]) -> None:
    check(figures(HEIGHTS_3D_M, 2.0, ("greedy", "optimal"))[policy], expected)
