"""What a report reads is refused in one line before anything is drawn."""

import copy
import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr
from report_runs import made_up_ablation, made_up_sensitivity, made_up_training, small_map, write_run

from cellpilot.errors import InputError
from cellpilot.runs.checks import check_metrics, check_variables


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory: pytest.TempPathFactory) -> xr.Dataset:
    folder = tmp_path_factory.mktemp("run")
    write_run(folder, small_map(), n_sampled=20)
    with xr.open_dataset(folder / "eval.nc", engine="h5netcdf") as data:
        return data.load()


def test_what_an_evaluation_writes_is_accepted(evaluated: xr.Dataset) -> None:
    metrics = json.loads(evaluated.attrs["metrics"])
    assert check_metrics(metrics, "eval.nc") == metrics
    assert check_variables(evaluated, "eval", "eval.nc") is evaluated
    for stem, data in (("train", made_up_training(5)), ("ablation", made_up_ablation()), ("sensitivity", made_up_sensitivity())):
        assert check_variables(data, stem, f"{stem}.nc") is data


def without(name: str) -> Callable[[dict[str, Any]], None]:
    return lambda metrics: metrics.pop(name)


@pytest.mark.parametrize(
    ("damage", "found"),
    [
        (without("exhaustive"), "metrics.exhaustive is None"),
        (without("n_pairs"), "metrics.n_pairs is None"),
        (without("policies"), "metrics.policies is None"),
        (lambda m: m.update(sampled={}), "metrics.sampled is {}"),
        (lambda m: m.update(policies=[1]), r"metrics.policies is \[1\]"),
        (lambda m: m.update(unreachable_pairs="x"), "metrics.unreachable_pairs is 'x'"),
        (lambda m: m["policies"].update(greedy=3), "metrics.policies.greedy is 3"),
        (lambda m: m["policies"]["greedy"].update(reached_share="all"), "greedy.reached_share is 'all'"),
        (lambda m: m["policies"]["greedy"].update(low_sinr_share=None), "greedy.low_sinr_share is None"),
        (lambda m: m["policies"]["greedy"].update(score=[0.1]), "greedy.score is"),
        (lambda m: m["sampled"]["greedy"].update(return_ci95=[1.0]), "greedy.return_ci95 is"),
        (lambda m: m["sampled"]["greedy"].update(altitude_share=1.0), "greedy.altitude_share is 1.0"),
        (lambda m: m["sampled"]["greedy"].update(rf_class_share={"good": 1.0}), "greedy.rf_class_share is"),
    ],
)
def test_damaged_metrics_name_the_entry(evaluated: xr.Dataset, damage: Callable[[dict[str, Any]], None], found: str) -> None:
    metrics = copy.deepcopy(json.loads(evaluated.attrs["metrics"]))
    damage(metrics)
    with pytest.raises(InputError, match=rf"^eval\.nc: .*{found}.*expected .*evaluate the run again"):
        check_metrics(metrics, "eval.nc")


@pytest.mark.parametrize("metrics", [{}, [], None, 3, "text"])
def test_metrics_of_another_kind_are_refused(metrics: object) -> None:
    with pytest.raises(InputError, match=r"eval\.nc: metrics"):
        check_metrics(metrics, "eval.nc")


@pytest.mark.parametrize(
    ("stem", "make", "name"),
    [
        ("train", lambda: made_up_training(5), "episode_return"),
        ("train", lambda: made_up_training(5), "exploration"),
        ("ablation", made_up_ablation, "episode_return"),
        ("sensitivity", made_up_sensitivity, "path_ratio_p90"),
    ],
)
def test_a_variable_that_is_missing_empty_or_no_number_is_named(stem: str, make: Callable[[], xr.Dataset], name: str) -> None:
    data = make()
    text = data[name].astype(str)
    for damaged in (data.drop_vars(name), data.assign({name: text}), data.isel({data[name].dims[-1]: slice(0)})):
        with pytest.raises(InputError, match=rf"^{stem}\.nc: "):
            check_variables(damaged, stem, f"{stem}.nc")
    with pytest.raises(InputError, match=name):
        check_variables(data.assign({name: ("other", np.zeros(3))}), stem, f"{stem}.nc")


def test_an_evaluation_without_policies_is_refused(evaluated: xr.Dataset) -> None:
    with pytest.raises(InputError, match=r"eval\.nc: reached"):
        check_variables(evaluated.isel(policy=slice(0)), "eval", "eval.nc")
    with pytest.raises(InputError, match="policy"):
        check_variables(evaluated.drop_vars("policy"), "eval", "eval.nc")
