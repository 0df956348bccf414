"""From one map to another network: prepared on map A, deployed where the unknown truth is map B (`cellpilot adapt`).

Every arm flies the same random start-goal pairs of a seed in B, and is scored after some of these flights on all pairs
of B: 0 = greedy baseline, 1 = exact optimum.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cellpilot.errors import InputError
from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.evaluate.metrics import METRICS, return_mean, score
from cellpilot.evaluate.statistics import half_interval
from cellpilot.evaluate.summary import Summary
from cellpilot.experiment import build_map
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.learn.algorithms.map_learner import learn_map, without_holes
from cellpilot.learn.algorithms.map_learner_settings import MOST_LEARNED_CELLS, MapLearning
from cellpilot.maps.estimate.gaussian_process import Kernel
from cellpilot.policies import GreedyPolicy, OptimalPolicy, Policy
from cellpilot.provenance import digest
from cellpilot.scenario import MapFile, MapSettings, MeasuredMap, Scenario, SimulatedMap, find_scenario, load_scenario
from cellpilot.storage import load_array, save_array
from cellpilot.task import Task
from cellpilot.world import World

if TYPE_CHECKING:
    import xarray as xr

    from cellpilot.learn.algorithms.fqi_her import FittedState
    from cellpilot.maps import RadioMap

WHOLE_AREA_M = 100_000.0
"""Holes of a log given as such are filled from neighbours this near: all of them, so that B has a truth everywhere."""
CHECKPOINTS = (0, 1, 2, 3, 5, 7, 10, 15, 20, 30, 50, 70, 100, 150, 200, 300, 500, 700, 1_000, 2_000, 5_000, 10_000)
"""Numbers of flights after which policies are scored."""


@dataclass(frozen=True, eq=False)
class Transfer:
    """What there is before the first flight, and the truth that only measurements show."""

    task: Task
    prepared: World  # map A on the grid of B; it may be wrong everywhere
    truth: World  # map B, without uncertainty
    deep: FQIHER  # how the deep policy is trained on map A


Arm = Callable[[Transfer, int, Sequence[int]], Iterator[Policy]]
"""(transfer, seed, checkpoints) -> its deterministic policy after each number of flights, which are increasing."""


PRIOR_KERNEL = Kernel(offset_std_db=5.0, height_offset_std_db=2.0)
"""A prior map knows the level better than nothing does."""


def _map_with_prior(transfer: Transfer, seed: int, checkpoints: Sequence[int]) -> Iterator[Policy]:
    known_db = transfer.prepared.signal.mean_db.astype(np.float64)
    for learner in learn_map(transfer.truth, transfer.task, MapLearning(), seed, checkpoints, known_db, PRIOR_KERNEL):
        yield learner.policy()


def _map_from_nothing(transfer: Transfer, seed: int, checkpoints: Sequence[int]) -> Iterator[Policy]:
    for learner in learn_map(transfer.truth, transfer.task, MapLearning(), seed, checkpoints):
        yield learner.policy()


@lru_cache(maxsize=1)
def _trained(transfer: Transfer, seed: int) -> "FittedState":
    """FQI-HER trained on map A, once for both arms that fly it, which follow each other."""
    from cellpilot.learn.algorithms.fqi_her_online import train_beforehand

    return train_beforehand(transfer.deep, transfer.prepared, transfer.task, seed)


def _frozen(transfer: Transfer, seed: int, checkpoints: Sequence[int]) -> Iterator[Policy]:
    from cellpilot.learn.algorithms.fqi_her_online import argmax_policy

    policy = argmax_policy(_trained(transfer, seed), transfer.deep, transfer.truth.grid, transfer.task)
    yield from [policy] * len(checkpoints)


def _online(transfer: Transfer, seed: int, checkpoints: Sequence[int]) -> Iterator[Policy]:
    from cellpilot.learn.algorithms.fqi_her_online import learn_online

    yield from learn_online(_trained(transfer, seed), transfer.deep, transfer.truth, transfer.task, seed, checkpoints)


PRIOR, NOTHING, FROZEN, ONLINE = "map-prior", "map-nothing", "deep-frozen", "deep-online"
ARMS: dict[str, Arm] = {PRIOR: _map_with_prior, NOTHING: _map_from_nothing, FROZEN: _frozen, ONLINE: _online}
LABELS = {
    PRIOR: "map learner, A as prior",
    NOTHING: "map learner from nothing",
    FROZEN: "deep policy of A, frozen",
    ONLINE: "deep policy of A, learns on",
}


def checkpoints_up_to(flights: int) -> list[int]:
    """Numbers of flights after which policies are scored, the last one among them."""
    return [*(n for n in CHECKPOINTS if n < flights), flights]


SHOWN_FLIGHTS = (0, 1, 3, 5, 10, 20, 50, 100, 200, 500, 1_000)
"""Numbers of flights with a row in the table."""
ADAPT_FIGURES = ("score", "reached_share", "path_ratio_p90")
"""What is kept of each policy."""


def adapt(
    transfer: Transfer,
    flights: int,
    n_seeds: int,
    arms: Sequence[str] = tuple(ARMS),
    progress: Callable[[float], None] = lambda share: None,
    folder: Path | None = None,
) -> "xr.Dataset":
    """`ADAPT_FIGURES` over `(arm, seed, flights)`, on all pairs of the true map.

    With a `folder`, every finished curve is kept there, and one that is there need not be flown again.
    """
    import xarray as xr

    world, task = transfer.truth, transfer.task
    policies = GreedyPolicy(world), OptimalPolicy(world, task), OptimalPolicy(transfer.prepared, task)
    greedy, optimal, optimal_of_a = (exhaustive_summary(None, world, task, policy) for policy in policies)
    if score(greedy, greedy, optimal) is None:
        raise InputError("on map B the optimum is no better than the shortest path: choose a threshold that part of it misses")
    checkpoints = checkpoints_up_to(flights)
    found = np.empty((len(ADAPT_FIGURES), len(arms), n_seeds, len(checkpoints)))
    for i, seed in enumerate(range(n_seeds)):
        for j, name in enumerate(arms):
            within = lambda share, i=i, j=j: progress((i * len(arms) + j + share) / (n_seeds * len(arms)))
            file = None if folder is None else folder / f"{name}-{seed}-{_mark(transfer, checkpoints)}.npy"
            curve = load_array(file) if file is not None and file.is_file() else None
            if curve is None:
                curve = _curve(transfer, name, seed, checkpoints, greedy, optimal, within)
                if file is not None:
                    save_array(curve, file)
            found[:, j, i] = curve
            within(1.0)
    dims = ("arm", "seed", "flights")
    return xr.Dataset(
        {name: (dims, found[i], {"units": "1"}) for i, name in enumerate(ADAPT_FIGURES)},
        coords={"arm": list(arms), "seed": np.arange(n_seeds), "flights": checkpoints},
        attrs={
            "threshold_db": task.threshold_db,
            "noise_std_db": world.signal.noise_std_db,
            "greedy_return": return_mean(greedy),
            "optimal_return": return_mean(optimal),
            "score_of_optimum_of_a": score(optimal_of_a, greedy, optimal),
            "labels": json.dumps({name: LABELS[name] for name in arms}),
        }
        | likeness(transfer),
    )


def _curve(
    transfer: Transfer,
    arm: str,
    seed: int,
    checkpoints: Sequence[int],
    greedy: Summary,
    optimal: Summary,
    progress: Callable[[float], None],
) -> np.ndarray:
    """`ADAPT_FIGURES` of one arm and seed `[figures, checkpoints]`; NaN where there is none."""
    columns: list[list[float]] = []
    scored: Policy | None = None
    for policy in ARMS[arm](transfer, seed, checkpoints):
        if policy is not scored:
            found = exhaustive_summary(None, transfer.truth, transfer.task, policy)
            row = (score(found, greedy, optimal), *(METRICS[name].compute(found) for name in ADAPT_FIGURES[1:]))
            scored = policy
        columns.append([np.nan if value is None else value for value in row])
        progress(len(columns) / len(checkpoints))
    return np.array(columns).T


def _mark(transfer: Transfer, checkpoints: Sequence[int]) -> str:
    """Names everything a curve depends on besides arm and seed."""
    truth, prepared = transfer.truth, transfer.prepared
    text = repr((transfer.task, truth.signal.noise_std_db, truth.grid, PRIOR_KERNEL, MapLearning(), transfer.deep, checkpoints))
    return digest([truth.signal.mean_db, truth.airspace.reason, prepared.signal.mean_db, np.frombuffer(text.encode(), np.uint8)])


def likeness(transfer: Transfer) -> dict[str, float]:
    """How like A is to B in the free cells: correlation of SINR (NaN for a map without pattern), mean of A minus mean of B
    [dB], and shares of cells: both or neither below the threshold, A below it, B below it.
    """
    free = transfer.truth.airspace.free_cells
    a_db, b_db = (world.signal.mean_db[free].astype(np.float64) for world in (transfer.prepared, transfer.truth))
    low_a, low_b = a_db < transfer.task.threshold_db, b_db < transfer.task.threshold_db
    flat = a_db.std() == 0 or b_db.std() == 0
    return {
        "correlation": np.nan if flat else float(np.corrcoef(a_db, b_db)[0, 1]),
        "level_difference_db": float(a_db.mean() - b_db.mean()),
        "threshold_agreement": float((low_a == low_b).mean()),
        "low_share_a": float(low_a.mean()),
        "low_share_b": float(low_b.mean()),
    }


def summary(data: "xr.Dataset") -> list[list[str]]:
    """Mean score of each arm and half of its 95 % interval, after each number of flights; first the headings.

    An arm that leaves some pair unreached at any time has a column with the share it reaches. Where both are there, the
    lead of the map learner with the prior over the one without is the mean of the differences seed by seed.
    """
    arms, flights = data["arm"].values.tolist(), data["flights"].values.tolist()
    columns: dict[str, list[str]] = {"flights": [str(n) for n in flights]}
    for arm in arms:
        columns[arm] = _with_interval(data["score"].sel(arm=arm))
        reached = data["reached_share"].sel(arm=arm)
        if (reached < 1).any():
            columns[f"{arm}: reached"] = [f"{100 * share:.1f} %" for share in reached.mean("seed").values]
    if {PRIOR, NOTHING} <= set(arms):
        columns["lead of the prior"] = _with_interval(data["score"].sel(arm=PRIOR) - data["score"].sel(arm=NOTHING), "+.3f")
    rows = [list(row) for row in zip(*columns.values(), strict=True)]
    return [list(columns), *(row for n, row in zip(flights, rows, strict=True) if n in SHOWN_FLIGHTS or n == flights[-1])]


def _with_interval(values: "xr.DataArray", form: str = ".3f") -> list[str]:
    """Mean over seeds and half of its 95 % interval, for each number of flights."""
    scores = values.transpose("flights", "seed").values
    spread = ["" if np.isnan(half) else f" ± {half:.3f}" for half in half_interval(scores)]
    return [f"{mean:{form}}{plus_minus}" for mean, plus_minus in zip(scores.mean(-1), spread, strict=True)]


def in_words(data: "xr.Dataset") -> str:
    """How like A and B are, as `likeness` found, and what the best of all policies of A is worth in B."""
    like = data.attrs
    return (
        f"A and B: correlation {like['correlation']:.2f}; {like['threshold_agreement']:.0%} of the cells on the same side of the "
        f"threshold (below it: {like['low_share_a']:.0%} in A, {like['low_share_b']:.0%} in B); mean of A minus mean of B "
        f"{like['level_difference_db']:+.1f} dB; the exact optimum of A scores {like['score_of_optimum_of_a']:.3f} in B"
    )


def verdict(data: "xr.Dataset", good: float = 0.9) -> list[str]:
    """In words: how A as a prior compares with none, over the flights, seed by seed."""
    if not {PRIOR, NOTHING} <= set(data["arm"].values.tolist()):
        return []
    flights = data["flights"].values
    prior, nothing = (data["score"].sel(arm=name).values for name in (PRIOR, NOTHING))
    if len(prior) == 1:
        return ["one seed tells no interval: give --seeds 2 or more to compare the prior with none"]
    difference = (prior - nothing).T
    mean, half = difference.mean(-1), half_interval(difference)
    lines = []
    for ahead, what in ((mean - half > 0, "helps"), (mean + half < 0, "harms")):
        at = [int(n) for n, is_ahead in zip(flights, ahead, strict=True) if is_ahead]
        if at:
            lines.append(f"the prior {what} (95 % interval of the paired difference beyond 0) after {_listed(at)} flights")
    if not lines:
        lines.append("no number of flights shows a difference between prior and none (95 % intervals of the paired difference)")
    needed = [
        next((int(n) for n, s in zip(flights, curve.mean(0), strict=True) if s >= good), None) for curve in (prior, nothing)
    ]
    told = [f"not within {flights[-1]} flights" if n is None else f"after {n}" for n in needed]
    lines.append(f"mean score {good:g}: {told[0]} with the prior, {told[1]} without")
    return lines


def _listed(numbers: list[int]) -> str:
    return ", ".join(str(n) for n in numbers)


def read_place(text: str, bin_m: float) -> tuple[MapSettings, Scenario | None]:
    """What A or B names: a RadioMap file (.nc, .zarr, .tif), a measured log (.csv), or a scenario by file or name."""
    from cellpilot.maps.files import MAP_FORMATS

    suffix = Path(text).suffix.lower()
    if suffix in MAP_FORMATS and suffix != ".csv":
        return MapFile(path=Path(text)), None
    if suffix == ".csv":
        return MeasuredMap(logs=(Path(text),), bin_m=bin_m, fill_radius_m=WHOLE_AREA_M), None
    scenario = load_scenario(find_scenario(text))
    return scenario.map, scenario


def make_transfer_maps(a: MapSettings, b: MapSettings, calibration: MapSettings | None = None) -> tuple["RadioMap", "RadioMap"]:
    """Maps A and B on their common grid.

    Where B is measured, a simulated A is simulated on the grid of B, and a measured A is gridded in the bins of B. Of
    two maps of one height each, A may be of another height than B. Only the rectangle that both cover is kept. With
    `calibration` (a map of the same network that is known beforehand, such as another height), a constant is added to
    A that makes its mean that of the calibration. `InputError` if the grids cannot be brought together.
    """
    map_b = build_map(b)
    map_a = _beside(a, map_b)
    if calibration is not None:
        known = _beside(calibration, map_b)["sinr_db"].values
        map_a = map_a.assign(sinr_db=map_a["sinr_db"] + np.float32(np.nanmean(known) - np.nanmean(map_a["sinr_db"].values)))
    return common_grid(map_a, map_b)


def _beside(settings: MapSettings, other: "RadioMap") -> "RadioMap":
    """The map of the settings, in the bins of the other one where it can be chosen."""
    from cellpilot.maps import anchor_of

    if isinstance(settings, SimulatedMap) and other.attrs["source"] != "simulation":
        x_m, y_m = other["x"].values, other["y"].values
        if min(x_m.size, y_m.size) < 2:
            raise InputError("map B has a single row of cells: nothing to simulate on")
        half_m = (x_m[1] - x_m[0]) / 2
        on_grid = {
            "x_range_m": (float(x_m[0] - half_m), float(x_m[-1] + half_m)),
            "y_range_m": (float(y_m[0] - half_m), float(y_m[-1] + half_m)),
            "bin_m": float(2 * half_m),
            "heights_m": tuple(float(z) for z in other["z"].values),
        }
        return build_map(settings.changed(**on_grid))
    return build_map(settings, anchor_of(other))


def common_grid(map_a: "RadioMap", map_b: "RadioMap") -> tuple["RadioMap", "RadioMap"]:
    """Both maps cut to the cells they share; `InputError` if their bins do not coincide or nothing is shared."""
    from cellpilot.maps import anchor_of

    anchors = anchor_of(map_a), anchor_of(map_b)
    if None not in anchors and anchors[0] != anchors[1]:
        places = [f"{anchor.latitude_deg:.6f}, {anchor.longitude_deg:.6f}" for anchor in anchors if anchor is not None]
        raise InputError(
            f"x = y = 0 lies at {places[0]} in one map and at {places[1]} in the other:"
            " give the logs, or import both with one anchor"
        )
    heights = map_a["z"].values, map_b["z"].values
    if len(heights[0]) == len(heights[1]) == 1:
        map_a = map_a.assign_coords(z=map_b["z"])
    elif not np.array_equal(*heights):
        shown = [", ".join(f"{z:g}" for z in z_m) for z_m in heights]
        raise InputError(f"the grids differ: heights {shown[0]} m in A, {shown[1]} m in B; expected the same")
    ranges = {axis: _shared(axis, map_a[axis].values, map_b[axis].values) for axis in "xy"}
    return tuple(m.isel({axis: slice(*ranges[axis][i]) for axis in "xy"}) for i, m in enumerate((map_a, map_b)))  # type: ignore[return-value]


def _shared(axis: str, a_m: np.ndarray, b_m: np.ndarray) -> tuple[tuple[int, int], tuple[int, int]]:
    """First and last index (exclusive) of the shared centres in each of two axes."""
    sides = [float(m[1] - m[0]) if len(m) > 1 else None for m in (a_m, b_m)]
    if None not in sides and not np.isclose(sides[0], sides[1]):  # type: ignore[arg-type]
        raise InputError(f"the grids differ: bins of {sides[0]:g} m in A, {sides[1]:g} m in B along {axis}; expected the same")
    shared = [i for i, centre in enumerate(a_m) if np.isclose(b_m, centre, rtol=0, atol=1e-3).any()]
    if not shared:
        where = [f"{m[0]:g} to {m[-1]:g}" for m in (a_m, b_m)]
        raise InputError(f"the grids differ: centres along {axis} from {where[0]} m in A, {where[1]} m in B; none is shared")
    first = int(np.flatnonzero(np.isclose(b_m, a_m[shared[0]], rtol=0, atol=1e-3))[0])
    return (shared[0], shared[-1] + 1), (first, first + len(shared))


def make_transfer(map_a: "RadioMap", map_b: "RadioMap", task: Task, noise_std_db: float, deep: FQIHER | None = None) -> Transfer:
    """The transfer between two maps of one grid; holes of A are its mean at their height.

    What is uncertain about a measured B is set aside: its map is the truth. `InputError` for a map that is too large.
    """
    truth = World.from_map(map_b, noise_std_db)
    if truth.grid.n_cells > MOST_LEARNED_CELLS:
        raise InputError(
            f"the maps have {truth.grid.n_cells:,} cells; adapt can hold {MOST_LEARNED_CELLS:,}: use larger bins or a part"
        )
    truth = replace(truth, signal=replace(truth.signal, unknown=None))
    prepared_db = without_holes(truth.grid, map_a["sinr_db"].values.ravel().astype(np.float64), task.threshold_db)
    prepared = replace(truth, signal=replace(truth.signal, mean_db=prepared_db.astype(np.float32)))
    return Transfer(task, prepared, truth, deep or FQIHER())
