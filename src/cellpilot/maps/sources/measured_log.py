"""Maps from measured logs: the mean SINR of each bin and height, holes filled from what is known around them."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from cellpilot.array_types import FloatArray
from cellpilot.errors import InputError
from cellpilot.maps.account import ATTRIBUTE, ImportAccount, LevelAccount, LogAccount
from cellpilot.maps.estimate.fill import FillMethod, fill
from cellpilot.maps.geodesy import Anchor, to_local
from cellpilot.maps.gridding import Bins, grid_samples
from cellpilot.maps.hover import Mask, densest_disc
from cellpilot.maps.reasons import NO_MEASUREMENT, blocked_cells
from cellpilot.maps.samples import STATED, TAKE_OFF, Samples
from cellpilot.maps.schema import RadioMap, make_map
from cellpilot.maps.settings import LOGS
from cellpilot.maps.sources.logs import LogOptions, read_log
from cellpilot.storage import resolved

Trend = Callable[[RadioMap], FloatArray]
"""SINR [dB] that a model predicts in every cell `[z, y, x]` of a map."""

AS_THE_LOG_SAYS = LogOptions()


def import_logs(
    paths: Sequence[str | Path],
    *,
    altitude_m: float | Sequence[float] | None = None,
    bin_m: float = LOGS.bin_m,
    height_step_m: float = LOGS.height_step_m,
    ground_altitude_m: float | None = None,
    fill_radius_m: float = LOGS.fill_radius_m,
    fill_method: FillMethod = LOGS.fill,
    mask: str | tuple[float, float, float] | None = LOGS.mask,
    unknown: str = LOGS.unknown,
    anchor: Anchor | None = None,
    options: LogOptions = AS_THE_LOG_SAYS,
    trend: Trend | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> RadioMap:
    """A RadioMap of the logs: the mean SINR of each bin and height, holes filled from neighbours.

    `altitude_m`: one height for all files or one for each; else from the names of the files or their own altitudes; these
    are put on the nearest multiple of `height_step_m`, less `ground_altitude_m` (see `heights_m`). `options`: see
    `read_log`. `mask`: "auto" leaves out the disc in which the drone hovered, if it did (see `hover.densest_disc`);
    (latitude [deg], longitude [deg], radius [m]) leaves out that one; None nothing. The bins that lose their samples are
    filled like any hole. `anchor`: where x = y = 0 and a bin corner lies; else the centre of the densest disc, masked or
    not, so that neither the order of the lines nor their spread over files moves a bin. `trend` says what SINR a simulation
    has in the cells. `fill_radius_m`, `fill_method`, `unknown`: see `fill`. `progress` hears how much of a Gaussian process
    is done.

    `sinr_std_db` is the standard error of the bin mean, with one pseudo-sample of the map's pooled variance: a bin of
    one sample gets the pooled spread, and two equal samples are not taken for certainty. Samples of one pass are
    correlated, so it is a lower bound. `account_of` gives what was kept, dropped, masked and filled.
    `InputError` for anything `read_log`, `grid_samples`, `fill` or `validate` refuse, a file given twice, or a mask
    that holds every sample.
    """
    samples, accounts = read_logs([Path(path) for path in paths], altitude_m, options)
    measured = samples[np.isfinite(samples.sinr_db)]
    latitude_deg, longitude_deg, sinr_db = measured.latitude_deg, measured.longitude_deg, measured.sinr_db
    densest, hovering = densest_disc(latitude_deg, longitude_deg)
    disc = _mask(mask, densest if hovering else None)
    anchor = anchor or Anchor(densest.latitude_deg, densest.longitude_deg)
    keep = np.ones(sinr_db.size, bool) if disc is None else ~disc.holds(latitude_deg, longitude_deg)
    if disc is not None and keep.all():
        raise InputError(
            f"the mask of {disc.radius_m:g} m around {disc.latitude_deg:.6f}, {disc.longitude_deg:.6f} holds no sample:"
            " leave it out"
        )
    if not keep.any():
        raise InputError(f"the mask holds all {keep.size} samples: give a smaller radius or no mask")
    x_m, y_m = to_local(latitude_deg, longitude_deg, anchor)
    bins = grid_samples(x_m, y_m, heights_m(measured, height_step_m, ground_altitude_m), sinr_db, bin_m, keep)
    gridded = make_map(
        bins.mean,
        x_m=bins.x_m,
        y_m=bins.y_m,
        z_m=bins.z_m,
        sinr_std_db=_standard_error(bins),
        count=bins.count,
        blocked_reason=bins.count == 0,
        reasons=(NO_MEASUREMENT,),
        optional={"sinr_spread_db": bins.std},
        anchor=anchor,
        source="measured log",
        model=f"mean SINR per bin of {bin_m:g} m",
        attributes={"bin_m": float(bin_m)} | _mask_attributes(disc, int((~keep).sum())),
    )
    trend_db = None if trend is None else trend(gridded)
    result = fill(gridded, fill_radius_m, method=fill_method, unknown=unknown, trend_db=trend_db, progress=progress)
    logs = tuple(sorted(accounts, key=lambda log: (log.altitude_m, log.file)))
    spot = None if disc is None else (disc.latitude_deg, disc.longitude_deg, disc.radius_m)
    account = ImportAccount(logs, int((~keep).sum()), spot, mask == "auto" and disc is not None, _levels(result))
    result.attrs[ATTRIBUTE] = account.to_json()
    return result


def read_logs(
    paths: Sequence[Path], altitude_m: float | Sequence[float] | None = None, options: LogOptions = AS_THE_LOG_SAYS
) -> tuple[Samples, list[LogAccount]]:
    """All samples of several logs, and the account of each; `InputError` for a log given twice."""
    if not paths:
        raise InputError("no log given; expected one CSV file per flight height")
    heights_m = list(altitude_m) if isinstance(altitude_m, Sequence) else [altitude_m] * len(paths)
    if len(heights_m) != len(paths):
        raise InputError(f"{len(heights_m)} altitudes for {len(paths)} log(s); expected one for all or one for each")
    seen: set[Path] = set()
    for path in paths:
        if resolved(path) in seen:
            raise InputError(f"{path}: the log is given twice, which would count its samples twice: leave one out")
        seen.add(resolved(path))
    read = [
        read_log(path, replace(options, altitude_m=options.altitude_m if height_m is None else height_m))
        for path, height_m in zip(paths, heights_m, strict=True)
    ]
    return Samples.joined([table for table, _ in read]), [account for _, account in read]


def heights_m(samples: Samples, step_m: float, ground_altitude_m: float | None) -> FloatArray:
    """Height above take-off of every sample [m]: as stated, or the log's own altitude on the nearest multiple of the step.

    `ground_altitude_m` is the altitude of take-off where a log counts from the ellipsoid or the sea; `InputError` without it.
    """
    if not np.isfinite(step_m) or step_m <= 0:
        raise InputError(f"the height step is {step_m:g} m; expected more than 0")
    result_m = samples.altitude_m.copy()
    above_ground = np.isin(samples.altitude_reference, (STATED, TAKE_OFF))
    if ground_altitude_m is None and not above_ground.all():
        first = int(np.flatnonzero(~above_ground)[0])
        lowest_m = float(result_m[~above_ground].min())
        raise InputError(
            f"{samples.source[first]}: its altitudes count from the {samples.altitude_reference[first]},"
            f" the lowest is {lowest_m:.1f} m;"
            " say where height 0 is: `ground_altitude_m` METRES, or one height for all samples: `altitude_m` METRES"
        )
    if ground_altitude_m is not None and above_ground.all():
        raise InputError("the altitude of the ground is given, but no log counts from the ellipsoid or the sea: leave it out")
    result_m[~above_ground] -= ground_altitude_m or 0.0
    below = ~above_ground & (result_m < 0)
    if 2 * below.sum() > (~above_ground).sum() > 0:
        raise InputError(
            f"{below.sum()} of {(~above_ground).sum()} samples would lie below height 0: the ground is given as"
            f" {ground_altitude_m:g} m, the lowest altitude is {float(samples.altitude_m[~above_ground].min()):.1f} m"
        )
    own = samples.altitude_reference != STATED
    result_m[own] = np.round(result_m[own] / step_m) * step_m
    return result_m


def _mask(wanted: str | tuple[float, float, float] | None, hover: Mask | None) -> Mask | None:
    if isinstance(wanted, str):
        if wanted != "auto":
            raise InputError(f"the mask is {wanted!r}; expected 'auto', nothing, or latitude, longitude [deg] and radius [m]")
        return hover
    return None if wanted is None else Mask(*wanted)


def _mask_attributes(disc: Mask | None, masked: int) -> dict[str, str | int | float]:
    if disc is None:
        return {"masked_count": 0}
    return {"masked_count": masked, **{f"mask_{name}": value for name, value in asdict(disc).items()}}


def _standard_error(bins: Bins) -> FloatArray:
    several = bins.count > 1
    freedom = np.where(several, bins.count - 1, 0)
    squares = freedom * np.where(several, bins.std, 0.0) ** 2
    if several.any():
        pooled_variance = squares.sum() / freedom.sum()
    else:
        # No bin shows its spread; the bins' own differences bound it from above.
        pooled_variance = np.nanvar(bins.mean, ddof=1) if (bins.count > 0).sum() > 1 else 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(bins.count > 0, np.sqrt((squares + pooled_variance) / bins.count**2.0), np.nan)


def _levels(dataset: RadioMap) -> tuple[LevelAccount, ...]:
    blocked, filled = blocked_cells(dataset), dataset["filled"].values
    counted = {
        "measured": dataset["count"].values > 0,
        "filled": filled,
        "blocked": blocked,
        "bad": np.isnan(dataset["sinr_db"].values) & ~blocked,
    }
    per_level = {name: cells.sum(axis=(1, 2)) for name, cells in counted.items()}
    return tuple(
        LevelAccount(float(height_m), **{name: int(cells[iz]) for name, cells in per_level.items()})
        for iz, height_m in enumerate(dataset["z"].values)
    )
