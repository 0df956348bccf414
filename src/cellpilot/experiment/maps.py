"""The map that a scenario asks for, and the sites behind a simulated one."""

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cellpilot.errors import InputError
from cellpilot.radio.settings import HexagonalSettings
from cellpilot.scenario import LogSettings, MapFile, MapSettings, MeasuredMap, SimulatedMap
from cellpilot.text import in_section

if TYPE_CHECKING:
    from cellpilot.maps import Anchor, LogOptions, RadioMap, SiteList
    from cellpilot.maps.estimate.holdout import HoldOut
    from cellpilot.radio import Deployment


def build_map(
    settings: MapSettings, anchor: "Anchor | None" = None, progress: Callable[[float], None] = lambda share: None
) -> "RadioMap":
    """The radio map a scenario asks for: simulated, imported or read. `anchor` is where the local metres of a log begin."""
    from cellpilot.maps import load_map

    if isinstance(settings, MapFile):
        return load_map(settings.path)
    if isinstance(settings, MeasuredMap):
        try:
            return make_measured_map(settings, anchor, progress)
        except InputError as error:
            raise InputError(in_section("map", str(error), MeasuredMap.model_fields)) from error
    return make_simulated_map(settings, progress)


def make_measured_map(
    settings: LogSettings, anchor: "Anchor | None" = None, progress: Callable[[float], None] = lambda share: None
) -> "RadioMap":
    """The map of the logs in the settings."""
    from cellpilot.maps import import_logs

    if not settings.logs:
        raise InputError(
            "the scenario needs a measured log: give `map.logs` FILE, or make a map of it first (cellpilot map import)"
        )
    radio_map = import_logs(
        settings.logs,
        altitude_m=settings.altitude_m,
        ground_altitude_m=settings.ground_altitude_m,
        height_step_m=settings.height_step_m,
        bin_m=settings.bin_m,
        fill_radius_m=settings.fill_radius_m,
        fill_method=settings.fill,
        mask=None if settings.mask == "none" else settings.mask,
        unknown=settings.unknown,
        anchor=anchor,
        options=log_options(settings),
        trend=None if settings.trend is None else partial(_trend_db, settings),
        progress=progress,
    )
    if settings.trend is not None:
        radio_map.attrs["trend"] = f"{settings.trend.name}, {settings.trend_environment}"
    return radio_map


def _trend_db(settings: LogSettings, radio_map: "RadioMap") -> NDArray[np.float64]:
    """What the simulation of the settings' site list says in the cells of a map `[z, y, x]`."""
    from cellpilot.maps import anchor_of, read_sites
    from cellpilot.radio import simulate

    assert settings.trend is not None
    sites = read_sites(settings.trend, anchor_of(radio_map))
    if not sites.in_degrees:
        raise InputError(f"{settings.trend}: the sites are in metres; a trend needs them in degrees, as the log is")
    _check_near(settings.trend, sites.deployment, radio_map["x"].values, radio_map["y"].values)
    z_m, y_m, x_m = (radio_map[axis].values for axis in "zyx")
    return simulate(sites.deployment, x_m, y_m[:, None], z_m[:, None, None], settings.trend_environment).sinr_db


FARTHEST_SITE_M = 50_000.0
"""An area farther from every site has no network, but a mistake in its coordinates."""


def _check_near(path: Path, deployment: "Deployment", x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> None:
    away_m = [
        np.maximum(np.maximum(axis.min() - of, of - axis.max()), 0) for axis, of in ((x_m, deployment.x_m), (y_m, deployment.y_m))
    ]
    nearest_m = float(np.hypot(*away_m).min())
    if nearest_m > FARTHEST_SITE_M:
        raise InputError(
            f"{path}: the nearest site lies {nearest_m / 1000:,.0f} km from the area; expected at most"
            f" {FARTHEST_SITE_M / 1000:g} km: are the coordinates of the list, or of x = y = 0, right?"
        )


def holdout_of(
    settings: LogSettings, bin_m: float, block_m: float, progress: Callable[[float], None] = lambda share: None
) -> "dict[str, HoldOut]":
    """Errors of each way to fill holes on hidden blocks of the settings' logs, in cells of `bin_m`.

    With a trend in the settings the Gaussian process departs from it, as the filling would.
    """
    from cellpilot.maps.estimate.fill import measured_cells
    from cellpilot.maps.estimate.holdout import block_holdout
    from cellpilot.maps.estimate.methods import (
        Method,
        gaussian_process,
        height_mean,
        inverse_distance,
        without_trend,
    )

    if block_m < bin_m:
        raise InputError(
            f"blocks of {block_m:g} m are smaller than cells of {bin_m:g} m: hide larger blocks, or use smaller cells"
        )
    radio_map = make_measured_map(settings.model_copy(update={"bin_m": bin_m, "fill_radius_m": 0.0, "trend": None}))
    methods: dict[str, Method] = {
        "mean per height": height_mean,
        "inverse distance": inverse_distance(settings.fill_radius_m or np.inf),
        "Gaussian process": without_trend(gaussian_process),
    }
    trend_db = None
    if settings.trend is not None:
        trend_db = _trend_db(settings, radio_map)
        methods["Gaussian process, trend"] = gaussian_process
    return block_holdout(measured_cells(radio_map, trend_db), methods, block_m, progress=progress)


WIDEST_RINGS = 40
"""4,921 sites: no wider layout is simulated to judge another, so that the judgement takes no time."""


def layout_warning(deployment: "Deployment", settings: SimulatedMap, tolerated_db: float = 1.0) -> str | None:
    """A sentence if a regular layout lacks outer rings: how much too good its SINR is at the highest level, and what mends it.

    A layout is compared with one whose rings reach 5 km farther, on 5 x 5 places over the area. The advice is the smallest
    number of rings that passes. Where that is beyond `WIDEST_RINGS` the comparison ends there, and no number is advised.
    """
    from cellpilot.radio import simulate

    if settings.sites is not None or settings.rings >= WIDEST_RINGS:
        return None
    more = int(min(np.ceil(5_000.0 / settings.inter_site_distance_m), WIDEST_RINGS))
    x_m, y_m = (np.linspace(*limits, 7)[1:-1] for limits in (settings.x_range_m, settings.y_range_m))
    place = (x_m, y_m[:, None], np.full((1, 1), settings.heights_m[-1]))

    @cache
    def sinr_db(rings: int) -> NDArray[np.float64]:
        layout = deployment if rings == settings.rings else make_deployment(settings.changed(rings=rings))
        return simulate(layout, *place, settings.environment, "soft").sinr_db

    def excess_db(rings: int) -> NDArray[np.float64]:
        return sinr_db(rings) - sinr_db(min(rings + more, WIDEST_RINGS))

    def enough(rings: int) -> bool:
        return bool(excess_db(rings).max() <= tolerated_db)

    if enough(settings.rings):
        return None
    found_db = excess_db(settings.rings)
    advised = _smallest(enough, settings.rings, WIDEST_RINGS - more)
    how_many = advised or f"(how many is not known: no more than {WIDEST_RINGS} are tried)"
    return (
        f"{len(np.unique(deployment.site))} sites alone are up to {found_db.max():.1f} dB too good"
        f" at {settings.heights_m[-1]:g} m (mean {found_db.mean():.1f} dB) for a spot in a larger network:"
        f" add outer sites with `map.rings` {how_many}"
    )


def _smallest(holds: Callable[[int], bool], failing: int, most: int) -> int | None:
    """The smallest number above `failing` and up to `most` for which it holds, if it does from there on; None if for none."""
    step = 1
    while failing < most:
        tried = min(failing + step, most)
        if holds(tried):
            break
        failing, step = tried, 2 * step
    else:
        return None
    while tried - failing > 1:
        middle = (failing + tried) // 2
        failing, tried = (failing, middle) if holds(middle) else (middle, tried)
    return tried


def log_options(settings: LogSettings) -> "LogOptions":
    """What the settings say of how logs are read."""
    from cellpilot.maps import LogOptions
    from cellpilot.maps.sources.columns import named_columns

    log_format = None
    if settings.columns is not None:
        log_format = named_columns(
            settings.columns,
            settings.altitude_unit,
            settings.altitude_reference,
            height_stated=settings.altitude_m is not None,
        )
    return LogOptions(format=log_format, max_accuracy_m=settings.max_accuracy_m, max_age_s=settings.max_age_s)


def make_simulated_map(settings: SimulatedMap, progress: Callable[[float], None] = lambda share: None) -> "RadioMap":
    """The map of the deployment in the settings."""
    from cellpilot.maps import simulate_map

    sites = make_sites(settings)
    if settings.sites is not None:
        _check_near(settings.sites, sites.deployment, np.array(settings.x_range_m), np.array(settings.y_range_m))
    return simulate_map(
        sites.deployment,
        environment=settings.environment,
        los=settings.los,
        shadowing_seed=settings.shadowing_seed,
        x_range_m=settings.x_range_m,
        y_range_m=settings.y_range_m,
        heights_m=settings.heights_m,
        bin_m=settings.bin_m,
        points_per_side=settings.points_per_side,
        anchor=sites.anchor,
        names=sites.names,
        progress=progress,
    )


def make_sites(settings: SimulatedMap) -> "SiteList":
    """The sectors of the site list, or of the hexagonal deployment."""
    from cellpilot.maps import Anchor, SiteList, read_sites

    anchor = None if settings.anchor is None else Anchor(*settings.anchor)
    if settings.sites is not None:
        return read_sites(settings.sites, anchor, settings.noise_figure_db)
    return SiteList(make_deployment(settings), None, anchor)


def make_deployment(settings: HexagonalSettings) -> "Deployment":
    """The hexagonal deployment of a simulated map."""
    from cellpilot.radio import ColumnAntenna, hexagonal_deployment

    layout = {name: getattr(settings, name) for name in HexagonalSettings.__annotations__}
    return hexagonal_deployment(**layout, antenna=ColumnAntenna.of(settings))
