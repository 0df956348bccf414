"""The two studies: finished parts are kept, a second call makes the same result, the picture is drawn."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from cli_tools import BRIEF_FLAGS, Cli

from cellpilot.studies import sensitivity as studies

FEW = ("--learner.episodes", "12", "--learner.replay-start", "100")


def values(path: Path, name: str) -> np.ndarray:
    """One variable of a NetCDF file."""
    with xr.open_dataset(path, engine="h5netcdf") as dataset:
        return np.asarray(dataset[name].values)


def test_the_ablation_goes_on_where_it_stopped(place: Path, cli: Cli) -> None:
    call = ("ablation", "tiny.toml", "--seeds", "2", *FEW, "--out", "study")
    result = cli(*call)
    assert result.code == 0, result.err
    for variant in ("DQN", "DDQN", "DQN+HER", "DDQN+HER"):
        assert variant in result.out
    first = values(place / "study" / "ablation.nc", "episode_return")
    assert first.shape == (4, 2, 12)
    # Whether double Q shows in so few flights is chance; seeds and hindsight must.
    assert not any(np.array_equal(curves[0], curves[1]) for curves in first)
    assert not any(
        np.array_equal(first[plain, seed], first[hindsight, seed]) for plain, hindsight in ((0, 2), (1, 3)) for seed in (0, 1)
    )
    assert [path.suffix for path in (place / "study" / "figures").glob("ablation.p*")] != []
    kept = {path: path.stat().st_mtime_ns for path in (place / "study" / "ablation").glob("*.npy")}
    assert len(kept) == 8
    lost = next(path for path in kept if path.name.startswith("DQN+HER-1"))
    lost.unlink()
    (place / "study" / "ablation.nc").unlink()
    assert cli(*call).code == 0
    assert np.array_equal(values(place / "study" / "ablation.nc", "episode_return"), first)
    again = {path: path.stat().st_mtime_ns for path in (place / "study" / "ablation").glob("*.npy")}
    assert {path for path in kept if again[path] != kept[path]} == {lost}


def test_the_sensitivity_of_the_optimum_is_exact(place: Path, cli: Cli) -> None:
    result = cli("sensitivity", "tiny.toml", "--out", "study")
    assert result.code == 0, result.err
    file = place / "study" / "sensitivity.nc"
    knob, policy, low = (values(file, name) for name in ("knob", "policy", "low_sinr_share"))
    assert {str(k) for k in knob} == {"rho_sinr/rho_step", "rho_goal"}
    greedy = low[policy == "greedy"]
    assert (greedy == greedy[0]).all()
    optimal = low[(policy == "optimal") & (knob == "rho_sinr/rho_step")]
    assert (np.diff(optimal) <= 1e-12).all(), "a larger penalty must not raise the share below the threshold"
    assert optimal[-1] < greedy[0]
    assert list((place / "study" / "figures").glob("sensitivity.p*")) != []
    file.unlink()
    assert cli("sensitivity", "tiny.toml", "--out", "study").code == 0
    assert np.array_equal(values(file, "low_sinr_share"), low)


def test_the_sensitivity_trains_the_near_exact_learner_too(place: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(studies, "RATIOS", ())
    monkeypatch.setattr(studies, "GOAL_REWARDS", (5.0,))
    result = cli("sensitivity", "tiny.toml", "--learner.algorithm", "fqi-her", *BRIEF_FLAGS, "--learned", "--out", "study")
    assert result.code == 0, result.err
    assert values(place / "study" / "sensitivity.nc", "policy").tolist() == ["greedy", "optimal", "learned/argmax"]


def test_a_study_lets_go_of_the_programs_of_its_trainings(place: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    import jax

    forgotten: list[str] = []
    monkeypatch.setattr(jax, "clear_caches", lambda: forgotten.append("programs"))
    few = ("--learner.episodes", "5", "--learner.replay-start", "100", "--learner.updates-per-episode", "2")
    assert cli("ablation", "tiny.toml", "--seeds", "1", "--out", "study", *few).code == 0
    assert len(forgotten) == 4  # one for each variant
