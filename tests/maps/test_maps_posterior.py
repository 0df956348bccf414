"""A map that a Gaussian process filled is drawn from its posterior: against the dense formula."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cellpilot.envs.arena  # noqa: F401 (makes Unknown known to JAX)
from cellpilot.errors import InputError
from cellpilot.maps import Anchor, RadioMap, fill, grid_of, load_map, make_map, save_map
from cellpilot.maps.estimate import posterior
from cellpilot.maps.estimate.fill import is_measured
from cellpilot.maps.estimate.gaussian_process import Kernel
from cellpilot.maps.estimate.posterior import kernel_text, parsed_kernel
from cellpilot.maps.words import described
from cellpilot.signal import Unknown
from cellpilot.world import World

KERNEL = Kernel(5.0, 45.0, 30.0, offset_std_db=8.0, height_offset_std_db=3.0, noise_std_db=1.2)


def filled(ny: int = 3, heights_m: tuple[float, ...] = (30.0, 50.0)) -> RadioMap:
    """Two thirds of the cells measured, some of them often, and the rest filled; the kernel is ours."""
    rng = np.random.default_rng(3)
    shape = (len(heights_m), ny, 6)
    sinr_db = np.where(rng.random(shape) < 0.35, np.nan, rng.normal(3.0, 5.0, shape))
    known = np.isfinite(sinr_db)
    gridded = make_map(
        sinr_db,
        x_m=20.0 * np.arange(6),
        y_m=20.0 * np.arange(ny),
        z_m=heights_m,
        source="test",
        sinr_std_db=np.where(known, 0.4, np.nan),
        count=np.where(known, rng.integers(1, 9, shape), 0),
        anchor=Anchor(47.0, 8.0),
    )
    result = fill(gridded, 200.0, method="gaussian-process")
    result.attrs["fill_kernel"] = kernel_text(KERNEL)
    return result


def unknown_of(radio_map: RadioMap) -> Unknown:
    found = World.from_map(radio_map).signal.unknown
    assert found is not None
    return found


def covariance_db2(unknown: Unknown) -> np.ndarray:
    """Exact covariance of the maps drawn: a draw is linear in its normal numbers."""
    maps_db = unknown.draw(np.eye(len(unknown.std_db), dtype=np.float32)).astype(np.float64)
    return maps_db.T @ maps_db


def expected_db2(radio_map: RadioMap, prior: np.ndarray) -> np.ndarray:
    """Correlation of the posterior by the dense formula, times the spread of the map."""
    at = np.flatnonzero(is_measured(radio_map))
    noise = np.diag(KERNEL.noise_std_db**2 / radio_map["count"].values.ravel()[at])
    after = prior - prior[:, at] @ np.linalg.solve(prior[np.ix_(at, at)] + noise, prior[at])
    scale = np.nan_to_num(radio_map["sinr_std_db"].values.ravel()) / np.sqrt(np.diagonal(after))
    return after * np.outer(scale, scale)


def separable_prior(radio_map: RadioMap) -> np.ndarray:
    points_m = grid_of(radio_map).metres(np.arange(radio_map["sinr_db"].size))
    away_m = np.abs(points_m[:, None] - points_m[None])
    field = np.exp(-away_m[..., 0] / 45 - away_m[..., 1] / 45 - away_m[..., 2] / 30)
    return 25 * field + 64 + 9 * (away_m[..., 2] == 0)


def test_drawn_maps_have_the_posterior_and_the_spread_of_the_map() -> None:
    radio_map = filled()
    points_m = grid_of(radio_map).metres(np.arange(36))
    expected = expected_db2(radio_map, KERNEL.covariance(points_m, points_m))
    np.testing.assert_allclose(covariance_db2(unknown_of(radio_map)), expected, atol=2e-5)
    np.testing.assert_allclose(np.diagonal(expected), radio_map["sinr_std_db"].values.ravel() ** 2, rtol=1e-6)


def test_a_larger_map_has_the_posterior_of_the_product_over_the_axes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(posterior, "EXACT_CELLS", 10)
    monkeypatch.setattr(posterior, "AT_ONCE", 7)
    radio_map = filled()
    unknown = unknown_of(radio_map)
    assert unknown.measured is not None
    # A draw is a difference of float32 draws from the prior of 98 dB^2, which processors round differently.
    expected = expected_db2(radio_map, separable_prior(radio_map))
    np.testing.assert_allclose(covariance_db2(unknown), expected, atol=3e-6 * 98)
    normal = np.random.default_rng(0).standard_normal((5, 36), np.float32)
    traced_db = jax.jit(lambda u, n: u.draw(n))(jax.tree.map(jnp.asarray, unknown), jnp.asarray(normal))
    np.testing.assert_allclose(traced_db, unknown.draw(normal), atol=1e-3)


def test_both_ways_are_one_along_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    radio_map = filled(1, (30.0,))
    exact = covariance_db2(unknown_of(radio_map))
    monkeypatch.setattr(posterior, "EXACT_CELLS", 3)
    np.testing.assert_allclose(covariance_db2(unknown_of(radio_map)), exact, atol=1e-4)


def test_a_map_that_is_too_large_says_so_and_takes_the_length_of_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(posterior, "EXACT_CELLS", 10)
    monkeypatch.setattr(posterior, "MOST_POSTERIOR_CELLS", 35)
    large = filled()
    with pytest.raises(InputError, match=r"36 cells, .* are too many .* remove the attribute fill_kernel"):
        World.from_map(large)
    again = large.drop_attrs(deep=False).assign_attrs({n: v for n, v in large.attrs.items() if n != "fill_kernel"})
    assert "too many" in again.attrs["fill_posterior"]
    length_m = again.attrs["sinr_correlation_m"]
    assert f"error of the map: correlated over {length_m:g} m; 36 cells," in "\n".join(described(again, 3.0))
    expected = Unknown.of(grid_of(again), again["sinr_std_db"].values.ravel(), length_m)
    assert expected is not None
    np.testing.assert_array_equal(covariance_db2(unknown_of(again)), covariance_db2(expected))


@pytest.mark.parametrize("suffix", [".nc", ".zarr", ".csv", ".tif"])
def test_files_keep_what_the_posterior_is_made_of(tmp_path: Path, suffix: str) -> None:
    pytest.importorskip({".zarr": "zarr", ".tif": "rasterio"}.get(suffix, "numpy"))
    radio_map = filled()
    save_map(radio_map, tmp_path / f"map{suffix}")
    read = load_map(tmp_path / f"map{suffix}")
    np.testing.assert_array_equal(covariance_db2(unknown_of(read)), covariance_db2(unknown_of(radio_map)))
    assert "error of the map: drawn from the posterior of the Gaussian process" in list(described(read, 3.0))


def test_another_way_to_fill_leaves_no_posterior() -> None:
    radio_map = filled()
    assert "fill_kernel" in fill(radio_map, 200.0).attrs  # nothing was left to fill
    radio_map["sinr_db"].values[0, 0, 0], radio_map["blocked_reason"].values[0, 0, 0] = np.nan, 1
    assert "fill_kernel" not in fill(radio_map, 200.0).attrs


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", kernel_text(KERNEL)[:-1] + ', "more": 1}', kernel_text(KERNEL).replace("8.0", "NaN"), "[" * 50_000]
)
def test_a_kernel_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="fill_kernel is no kernel"):
        parsed_kernel(text)
    assert parsed_kernel(kernel_text(KERNEL)) == KERNEL
