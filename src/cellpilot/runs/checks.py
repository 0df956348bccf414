"""What a report reads of a run folder, checked before anything is drawn."""

from math import isnan
from typing import Any

import xarray as xr

from cellpilot.errors import InputError
from cellpilot.evaluate.metrics import RF_CLASSES_DB, number_metrics

FILE_VARIABLES: dict[str, dict[str, tuple[str, ...]]] = {
    "eval": {
        **dict.fromkeys(("reached", "n_steps", "shortest_steps", "drawn_return", "low_steps"), ("policy", "flight")),
        "sinr_histogram": ("policy", "sinr_bin"),
        "sinr_level_db": ("sinr_level",),
    },
    "train": dict.fromkeys(("episode_return", "n_steps", "reached", "exploration"), ("episode",)),
    "ablation": {"episode_return": ("variant", "seed", "episode")},
    "sensitivity": dict.fromkeys(
        ("value", "low_sinr_share", "path_ratio_mean", "path_ratio_p90", "reached_share"),
        ("point",),
    ),
}
"""Stem of a file -> its variables of numbers, and the dimensions of each."""

NAMES = {"eval": ("policy",), "ablation": ("variant",), "sensitivity": ("knob", "policy")}
"""Stem of a file -> what holds names in it."""


def check_variables(dataset: xr.Dataset, stem: str, where: str) -> xr.Dataset:
    """The dataset of `STEM.nc` itself; `InputError` if a variable is missing, empty, has other dimensions or no numbers."""
    for name, dims in FILE_VARIABLES[stem].items():
        if name not in dataset:
            raise InputError(f"{where}: the variable {name} is missing; make the file again")
        found = dataset[name]
        if set(found.dims) != set(dims) or not found.size or found.dtype.kind not in "biuf":
            shape = ", ".join(f"{dim}: {n}" for dim, n in found.sizes.items())
            raise InputError(
                f"{where}: {name} is {found.dtype} ({shape}); expected numbers over {', '.join(dims)}: make it again"
            )
    for name in NAMES.get(stem, ()):
        if name not in dataset or dataset[name].ndim != 1:
            raise InputError(f"{where}: the names {name} are missing; make the file again")
    return dataset


def check_metrics(metrics: Any, where: str) -> dict[str, Any]:
    """The attribute `metrics` of `eval.nc` itself; `InputError` naming the first entry that a report cannot show."""
    whole = _entries(metrics, "metrics", where)
    _need(isinstance(whole.get("exhaustive"), bool), "metrics.exhaustive", whole.get("exhaustive"), "true or false", where)
    for name in ("n_pairs", "unreachable_pairs", "sampled_goals"):
        wanted = name == "n_pairs" or name in whole
        _need(not wanted or _is_number(whole.get(name)), f"metrics.{name}", whole.get(name), "a number", where)
    for table in ("policies", "sampled"):
        rows = _entries(whole.get(table), f"metrics.{table}", where)
        _need(bool(rows), f"metrics.{table}", rows, "at least one policy", where)
        for policy, row in rows.items():
            _check_row(_entries(row, f"metrics.{table}.{policy}", where), f"metrics.{table}.{policy}", where)
    return whole


def _check_row(row: dict[str, Any], path: str, where: str) -> None:
    for name in ("reached_share", "low_sinr_share"):
        _need(_is_number(row.get(name)), f"{path}.{name}", row.get(name), "a number", where)
    for name in number_metrics():
        value = row.get(name)
        _need(value is None or _is_number(value, even_nan=True), f"{path}.{name}", value, "a number or null", where)
    for name in [metric.interval.name for metric in number_metrics().values() if metric.interval is not None]:
        bounds = row.get(name)
        fits = isinstance(bounds, list) and len(bounds) == 2 and all(b is None or _is_number(b, even_nan=True) for b in bounds)
        _need(bounds is None or fits, f"{path}.{name}", bounds, "two numbers or null", where)
    heights, classes = row.get("altitude_share"), row.get("rf_class_share")
    _need(isinstance(heights, list) and all(map(_is_number, heights)), f"{path}.altitude_share", heights, "numbers", where)
    named = isinstance(classes, dict) and all(_is_number(classes.get(name)) for name in RF_CLASSES_DB)
    _need(named, f"{path}.rf_class_share", classes, f"a number for each of {', '.join(RF_CLASSES_DB)}", where)


def _entries(value: Any, path: str, where: str) -> dict[str, Any]:
    _need(isinstance(value, dict), path, value, "named entries", where)
    return dict(value)


def _is_number(value: Any, even_nan: bool = False) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and (even_nan or not isnan(value))


def _need(fits: bool, path: str, value: Any, expected: str, where: str) -> None:
    if not fits:
        found = repr(value)
        shown = found if len(found) <= 40 else f"{found[:40]}..."
        raise InputError(f"{where}: {path} is {shown}; expected {expected}: evaluate the run again")
