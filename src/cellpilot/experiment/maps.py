"""The map that a scenario asks for, and the sites behind a simulated one."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cellpilot.errors import InputError
from cellpilot.scenario import LogSettings, MapFile, MapSettings, MeasuredMap, SimulatedMap

if TYPE_CHECKING:
    from cellpilot.maps import Anchor, LogOptions, RadioMap, SiteList
    from cellpilot.maps.estimate.holdout import HoldOut
    from cellpilot.radio import Deployment


def make_map(
    settings: MapSettings, anchor: "Anchor | None" = None, progress: Callable[[float], None] = lambda share: None
) -> "RadioMap":
    """The radio map a scenario asks for: simulated, imported or read. `anchor` is where the local metres of a log begin."""
    from cellpilot.maps import load_map

    if isinstance(settings, MapFile):
        return load_map(settings.path)
    if isinstance(settings, MeasuredMap):
        return make_measured_map(settings, anchor, progress)
    return make_simulated_map(settings, progress)


def make_measured_map(
    settings: LogSettings, anchor: "Anchor | None" = None, progress: Callable[[float], None] = lambda share: None
) -> "RadioMap":
    """The map of the logs in the settings."""
    from cellpilot.maps import import_logs

    if not settings.logs:
        raise InputError(
            "the scenario needs a measured log: give --map.logs FILE, or make a map of it first (cellpilot map import)"
        )
    return import_logs(
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


def _trend_db(settings: LogSettings, radio_map: "RadioMap") -> NDArray[np.float64]:
    """What the simulation of the settings' site list says in the cells of a map `[z, y, x]`."""
    from cellpilot.maps import anchor_of, read_sites
    from cellpilot.radio import simulate

    assert settings.trend is not None
    deployment = read_sites(settings.trend, anchor_of(radio_map)).deployment
    z_m, y_m, x_m = (radio_map[axis].values for axis in "zyx")
    return simulate(deployment, x_m, y_m[:, None], z_m[:, None, None], settings.trend_environment).sinr_db


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

    radio_map = make_measured_map(settings.model_copy(update={"bin_m": bin_m, "fill_radius_m": 0.0}))
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


def layout_warning(deployment: "Deployment", settings: SimulatedMap, tolerated_db: float = 1.0) -> str | None:
    """A sentence if a regular layout lacks outer rings: how much too good its SINR is at the highest level.

    The layout is compared with one whose rings reach 5 km farther, on 5 x 5 places over the area.
    """
    from cellpilot.radio import simulate

    if settings.sites is not None:
        return None
    more = int(np.ceil(5_000.0 / settings.inter_site_distance_m))
    x_m, y_m = (np.linspace(*limits, 7)[1:-1] for limits in (settings.x_range_m, settings.y_range_m))
    place = (x_m, y_m[:, None], np.full((1, 1), settings.heights_m[-1]))
    wide = make_deployment(settings.model_copy(update={"rings": settings.rings + more}))
    alone_db, among_db = (simulate(each, *place, settings.environment, "soft").sinr_db for each in (deployment, wide))
    excess_db = alone_db - among_db
    if excess_db.max() <= tolerated_db:
        return None
    return (
        f"{len(np.unique(deployment.site))} sites alone are up to {excess_db.max():.1f} dB too good"
        f" at {settings.heights_m[-1]:g} m (mean {excess_db.mean():.1f} dB) for a spot in a larger network:"
        f" add outer sites with --map.rings {settings.rings + more}"
    )


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


def make_deployment(settings: SimulatedMap) -> "Deployment":
    """The hexagonal deployment of a simulated map."""
    from cellpilot.radio import ColumnAntenna, hexagonal_deployment

    antenna = ColumnAntenna(
        settings.antenna_elements,
        settings.antenna_spacing_wavelengths,
        settings.electrical_tilt_deg,
        settings.mechanical_tilt_deg,
        settings.array_factor_floor_db,
    )
    return hexagonal_deployment(
        rings=settings.rings,
        inter_site_distance_m=settings.inter_site_distance_m,
        boresights_deg=settings.boresights_deg,
        base_height_m=settings.base_height_m,
        power_dbm=settings.power_dbm,
        carrier_hz=settings.carrier_hz,
        bandwidth_hz=settings.bandwidth_hz,
        noise_figure_db=settings.noise_figure_db,
        load=settings.load,
        antenna=antenna,
    )
