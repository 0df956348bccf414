"""Correlated fields: statistics over seeds (tolerance: four standard errors), and a value belongs to its place alone."""

import numpy as np
import pytest

from cellpilot.errors import InputError, RangeError
from cellpilot.radio import ENVIRONMENTS, Deployment, hexagonal_deployment, los_probability, received_power_dbm, shadow_std_db
from cellpilot.radio.shadowing import draw_shadowing

N_SEEDS = 1500
UMA = ENVIRONMENTS["UMa-AV"]


@pytest.fixture(scope="module")
def samples() -> dict[str, np.ndarray]:
    """Values `[seed, site, point]` at the origin, one and three correlation distances east, and one to the north."""
    out: dict[str, list[np.ndarray]] = {"los": [], "nlos": [], "state": []}
    distance = {"los": UMA.correlation_los_m, "nlos": UMA.correlation_nlos_m, "state": UMA.correlation_state_m}
    for seed in range(N_SEEDS):
        shadowing = draw_shadowing(seed, UMA, np.array([0, 1]))
        for kind, values in out.items():
            d = distance[kind]
            values.append(getattr(shadowing, kind).at(np.array([0.0, d, 3 * d, 0.0]), np.array([0.0, 0.0, 0.0, d])))
    return {kind: np.stack(values) for kind, values in out.items()}


@pytest.mark.parametrize("kind", ["los", "nlos", "state"])
def test_values_are_standard_normal_and_fall_off_exponentially(samples: dict[str, np.ndarray], kind: str) -> None:
    values = samples[kind]
    error = N_SEEDS**-0.5
    assert np.abs(values.mean(axis=0)).max() < 4 * error
    np.testing.assert_allclose(values.std(axis=0), 1.0, atol=4 * error / np.sqrt(2))
    correlation = np.corrcoef(values[:, 0].T)
    assert correlation[0, 1] == pytest.approx(np.exp(-1), abs=4 * error)
    assert correlation[0, 2] == pytest.approx(np.exp(-3), abs=4 * error)
    assert correlation[0, 3] == pytest.approx(np.exp(-1), abs=4 * error)


def test_sites_share_half_of_the_shadowing_and_nothing_of_the_state(samples: dict[str, np.ndarray]) -> None:
    for kind, expected in (("los", 0.5), ("nlos", 0.5), ("state", 0.0)):
        between = np.corrcoef(samples[kind][:, 0, 0], samples[kind][:, 1, 0])[0, 1]
        assert between == pytest.approx(expected, abs=4 * N_SEEDS**-0.5)


def test_the_three_fields_are_independent(samples: dict[str, np.ndarray]) -> None:
    correlation = np.corrcoef([samples[kind][:, 0, 0] for kind in ("los", "nlos", "state")])
    assert np.abs(correlation - np.eye(3)).max() < 4 * N_SEEDS**-0.5


def test_site_correlation_is_a_parameter() -> None:
    x = np.linspace(0, 500, 20)
    one, other = draw_shadowing(3, UMA, np.array([0, 1]), site_correlation=1.0).los.at(x, x)
    np.testing.assert_allclose(one, other)
    with pytest.raises(RangeError, match=r"site correlation is 1.5; expected 0..1"):
        draw_shadowing(3, UMA, np.array([0, 1]), site_correlation=1.5)


def test_one_map_already_has_the_right_correlation() -> None:
    """Over an area far larger than the correlation distance, one seed shows the exponential, not only the mean of many."""
    x = np.arange(0.0, 8000.0, 40.0)
    east, north = np.meshgrid(x, x)
    fields = draw_shadowing(5, UMA, np.array([0])).nlos
    here, there = (fields.at(east.ravel() + shift, north.ravel()) for shift in (0.0, UMA.correlation_nlos_m))
    assert np.corrcoef(here[0], there[0])[0, 1] == pytest.approx(np.exp(-1), abs=0.06)


def test_seeds_differ_and_repeat() -> None:
    deployment = hexagonal_deployment()
    first, again, other = (received_power_dbm(deployment, [0.0, 90.0], 20.0, 30.0, shadowing_seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).min() > 1e-6


@pytest.mark.parametrize("los", ["soft", "sampled", "los", "nlos"])
def test_a_value_depends_on_its_place_alone(los: str) -> None:
    deployment = hexagonal_deployment()
    generator = np.random.default_rng(0)
    x, y, z = *generator.uniform(-200, 200, (2, 400)), generator.choice([20.0, 60.0, 100.0], 400)
    together = received_power_dbm(deployment, x, y, z, los=los, shadowing_seed=7)  # type: ignore[arg-type]
    shuffle = generator.permutation(400)
    for some in (shuffle, shuffle[:13], shuffle[:1]):
        alone = received_power_dbm(deployment, x[some], y[some], z[some], los=los, shadowing_seed=7)  # type: ignore[arg-type]
        np.testing.assert_allclose(alone, together[:, some], rtol=0, atol=1e-9)


def test_more_sites_do_not_change_the_field_of_a_site() -> None:
    small, large = (received_power_dbm(hexagonal_deployment(rings), 50.0, 60.0, 30.0, shadowing_seed=7) for rings in (0, 2))
    np.testing.assert_allclose(large[:3], small, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("los", "state"), [("los", 0), ("nlos", 1)])
def test_shadowing_is_a_loss_scaled_by_the_spread_at_the_height(los: str, state: int) -> None:
    deployment = hexagonal_deployment(rings=1)
    height = np.array([20.0, 30.0, 60.0, 100.0])
    place = 120.0, -70.0
    shaded = received_power_dbm(deployment, *place, height, los=los, shadowing_seed=4)  # type: ignore[arg-type]
    loss = received_power_dbm(deployment, *place, height, los=los) - shaded  # type: ignore[arg-type]
    fields = draw_shadowing(4, UMA, deployment.site)
    value = (fields.los, fields.nlos)[state].at(np.array([place[0]]), np.array([place[1]]))
    std = shadow_std_db("UMa-AV", 2e9, 100.0, 25.0, height)[state]
    np.testing.assert_allclose(loss, value * std, atol=1e-9)
    np.testing.assert_allclose(loss[0], loss[1:3].mean(axis=0), atol=1e-9)  # sectors of one site share


def test_sampled_links_are_los_as_often_as_the_probability_says() -> None:
    deployment = hexagonal_deployment(rings=0, boresights_deg=(0.0,))
    x, height, n_seeds = np.array([60.0, 200.0, 500.0]), 20.0, 600
    seen = np.zeros(3)
    for seed in range(n_seeds):
        los, nlos, sampled = (
            received_power_dbm(deployment, x, 0.0, height, los=los, shadowing_seed=seed)  # type: ignore[arg-type]
            for los in ("los", "nlos", "sampled")
        )
        is_los = np.isclose(sampled[0], los[0], rtol=0, atol=1e-9)
        assert (is_los | np.isclose(sampled[0], nlos[0], rtol=0, atol=1e-9)).all()
        seen += is_los
    expected = los_probability("UMa-AV", x, height)
    assert (np.abs(seen / n_seeds - expected) < 4 * np.sqrt(expected * (1 - expected) / n_seeds)).all()


def _single_site() -> Deployment:
    return hexagonal_deployment(rings=0)


def test_soft_lies_between_the_states_with_the_same_seed() -> None:
    x = np.linspace(10, 400, 50)
    los, nlos, soft = (
        received_power_dbm(_single_site(), x, 30.0, 20.0, los=los, shadowing_seed=3)  # type: ignore[arg-type]
        for los in ("los", "nlos", "soft")
    )
    assert (soft <= np.maximum(los, nlos) + 1e-9).all()
    assert (soft >= np.minimum(los, nlos) - 1e-9).all()


@pytest.mark.parametrize("seed", [-1, 1.5, "7", True])
def test_bad_seeds(seed: object) -> None:
    with pytest.raises(InputError, match="shadowing seed is"):
        received_power_dbm(_single_site(), 0.0, 0.0, 30.0, shadowing_seed=seed)  # type: ignore[arg-type]
