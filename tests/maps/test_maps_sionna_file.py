"""Maps saved from Sionna RT: SINR as it is, or from path gains and the network behind them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellpilot.errors import InputError
from cellpilot.maps.reasons import blocked_cells
from cellpilot.maps.sources.sionna_file import Receiver, read_sionna

X_M, Y_M = np.array([-10.0, 10.0, 30.0]), np.array([5.0, 25.0])


def centres(z_m: float) -> np.ndarray:
    return np.stack(np.broadcast_arrays(X_M, Y_M[:, None], z_m), axis=-1).astype(np.float32)


def save(path: Path, z_m: float = 30.0, **arrays: Any) -> Path:
    np.savez(path, **({"cell_centers": centres(z_m)} | arrays))
    return path


@pytest.fixture
def gain() -> np.ndarray:
    """Two transmitters; nothing reaches the last cell."""
    gain = np.array([[[1e-8, 1e-9, 1e-10], [1e-8, 1e-9, 0.0]], [[1e-10, 1e-9, 1e-8], [1e-9, 1e-12, 0.0]]])
    return gain.astype(np.float32)


def test_sinr_from_path_gains_by_hand(tmp_path: Path, gain: np.ndarray) -> None:
    receiver = Receiver(power_dbm=40.0, bandwidth_hz=10e6, noise_figure_db=9.0, load=0.5)
    radio_map = read_sionna([save(tmp_path / "a.npz", path_gain=gain)], receiver)
    noise_mw = 10**-9.5
    for iy, ix in np.ndindex(2, 3):
        own, other = sorted(1e4 * gain[:, iy, ix].astype(float), reverse=True)
        found = radio_map["sinr_db"].values[0, iy, ix]
        if own == 0:
            assert np.isnan(found)
        else:
            assert found == pytest.approx(10 * np.log10(own / (0.5 * other + noise_mw)), abs=1e-4)
    assert blocked_cells(radio_map)[0].tolist() == [[False] * 3, [False, False, True]]
    assert radio_map["serving_sector"].values[0].tolist() == [[0, 0, 1], [0, 0, -1]]
    rsrp_dbm = 40 + 10 * np.log10(gain[0, 0, 0]) - 10 * np.log10(600)
    assert radio_map["rsrp_dbm"].values[0, 0, 0, 0] == pytest.approx(rsrp_dbm, abs=1e-4)
    assert (radio_map["x"].values.tolist(), radio_map["y"].values.tolist()) == (X_M.tolist(), Y_M.tolist())


def test_received_power_in_watts_says_the_same_as_path_gain(tmp_path: Path, gain: np.ndarray) -> None:
    by_gain = read_sionna([save(tmp_path / "a.npz", path_gain=gain)], Receiver(power_dbm=40.0))
    by_power = read_sionna([save(tmp_path / "b.npz", rss=gain * 10.0)])
    np.testing.assert_allclose(by_power["sinr_db"], by_gain["sinr_db"], atol=1e-4)
    assert "sector_power_dbm" not in by_power.coords


def test_a_sinr_of_its_own_is_taken_as_it_is_and_heights_are_put_in_order(tmp_path: Path, gain: np.ndarray) -> None:
    high = save(tmp_path / "high.npz", 50.0, sinr=gain * 1e9, path_gain=gain)
    low = save(tmp_path / "low.npz", 30.0, sinr=gain * 2e9, path_gain=gain)
    radio_map = read_sionna([high, low])
    assert radio_map["z"].values.tolist() == [30.0, 50.0]
    np.testing.assert_allclose(radio_map["sinr_db"][:, 0, 0], [10 * np.log10(20), 10.0], atol=1e-4)
    assert blocked_cells(radio_map)[:, 1, 2].all()


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"path_gain": np.ones((2, 3, 2))}, r"a\.npz: array 'path_gain' has shape \(2, 3, 2\)"),
        ({"path_gain": np.full((2, 2, 3), -80.0)}, r"a\.npz: array 'path_gain' has values below 0"),
        ({"gain": np.ones((2, 2, 3))}, r"a\.npz: arrays cell_centers, gain; expected 'cell_centers' and one of 'sinr'"),
        ({"sinr": np.ones((2, 2, 3)), "cell_centers": centres(30.0)[:, ::-1] * [1, 1, np.nan]}, "no horizontal grid"),
    ],
)
def test_what_does_not_fit_is_named(tmp_path: Path, arrays: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_sionna([save(tmp_path / "a.npz", **arrays)])


def test_files_that_differ_are_refused(tmp_path: Path, gain: np.ndarray) -> None:
    one = save(tmp_path / "one.npz", path_gain=gain)
    with pytest.raises(InputError, match=r"two\.npz: array 'cell_centers': the same height 30 m"):
        read_sionna([one, save(tmp_path / "two.npz", path_gain=gain)])
    with pytest.raises(InputError, match=r"three\.npz: .*other cells or array than"):
        read_sionna([one, save(tmp_path / "three.npz", 50.0, path_gain=gain[:1])])
    (tmp_path / "text.npz").write_text("30 m")
    with pytest.raises(InputError, match=r"text\.npz: cannot be read as arrays"):
        read_sionna([tmp_path / "text.npz"])
    with pytest.raises(InputError, match=r"gone\.npz: cannot be read"):
        read_sionna([tmp_path / "gone.npz"])


def test_a_file_that_ends_too_early_and_arrays_that_are_not_asked_for(tmp_path: Path, gain: np.ndarray) -> None:
    whole = save(tmp_path / "whole.npz", path_gain=gain, name=np.array("30 m"))
    assert read_sionna([whole])["sinr_db"].size == 6
    (tmp_path / "half.npz").write_bytes(whole.read_bytes()[:100])
    (tmp_path / "empty.npz").write_bytes(b"")
    for name in ("half", "empty"):
        with pytest.raises(InputError, match=rf"{name}\.npz: cannot be read as arrays"):
            read_sionna([tmp_path / f"{name}.npz"])
    with pytest.raises(InputError, match=r"inf\.npz: array 'path_gain' has values below 0, infinite"):
        read_sionna([save(tmp_path / "inf.npz", path_gain=np.full(gain.shape, np.inf))])
    with pytest.raises(InputError, match="rising x and y"):
        read_sionna([save(tmp_path / "down.npz", path_gain=gain, cell_centers=centres(30.0)[::-1])])


def test_what_of_the_receiver_has_no_effect_is_refused(tmp_path: Path, gain: np.ndarray) -> None:
    with pytest.raises(InputError, match=r"a\.npz: array 'rss' leaves power_dbm of the receiver without effect"):
        read_sionna([save(tmp_path / "a.npz", rss=gain)], Receiver(power_dbm=40.0))
    with pytest.raises(InputError, match=r"b\.npz: array 'sinr' leaves load"):
        read_sionna([save(tmp_path / "b.npz", sinr=gain)], Receiver(load=0.5))
