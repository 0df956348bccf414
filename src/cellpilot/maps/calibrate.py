"""A simulated map brought to the level and the spread of measurements."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from cellpilot.array_types import FloatArray
from cellpilot.errors import InputError
from cellpilot.maps.estimate.correlation import CORRELATION_M, along_axes, axis_factors, transposed
from cellpilot.maps.estimate.fill import is_measured, measured_cells
from cellpilot.maps.geodesy import to_degrees, to_local
from cellpilot.maps.schema import RadioMap, anchor_of, grid_of, validate


class Fit(NamedTuple):
    """A simulation against measurements of the same cells."""

    mean_error_db: float  # simulation less measurement
    spread_ratio: float  # standard deviation of the simulation over that of the measurements
    rmse_db: float
    correlation: float


class Calibration(NamedTuple):
    """The calibrated map, what was done to it, and how it fits before and after."""

    radio_map: RadioMap
    offset_db: float
    offset_std_db: float  # how uncertain the offset is: an error common to all cells
    spread_factor: float
    cells: int
    before: Fit
    after: Fit


def calibrate(simulated: RadioMap, measured: RadioMap) -> Calibration:
    """The simulated map with SINR' = mean + factor x (SINR - mean) + offset, so that mean and spread are those measured.

    Measured cells are looked up in the simulation by linear interpolation; those outside it do not count. Both need an
    anchor, or both none. `sinr_std_db` of the result is the root mean square error that is left: what the simulation does
    not know. A part of it, `sinr_common_std_db`, is common to all cells: the standard error of the offset, for errors of
    measured cells that are correlated over the distance that the simulation states (50 m where it states none). That of
    the factor is left out. The spread within cells is stretched too; the received power of every sector is left out.
    Offset, factor, and the fit before and after are kept in the attributes. `InputError` for fewer than 3 cells in
    common, or a simulation or measurements without any spread.
    """
    source = str(measured.attrs.get("source"))
    if source in ("simulation", "ray tracing"):
        raise InputError(f"the map to calibrate to comes from {source}, not from measurements: give one of measured logs")
    known = measured_cells(measured)
    predicted_db = _look_up(simulated, _local_to(simulated, measured, known.points_m))
    inside = np.isfinite(predicted_db)
    if inside.sum() < 3:
        raise InputError(
            f"{inside.sum()} measured cells lie within the simulated map; expected at least 3:"
            " simulate the area and heights of the log"
        )
    predicted_db, truth_db = predicted_db[inside], known.mean_db[inside]
    if predicted_db.std() == 0:
        raise InputError("the simulation has the same SINR in all measured cells: there is no spread to fit")
    if truth_db.std() == 0:
        raise InputError("all measured cells have the same SINR: there is no spread to fit the simulation to")
    factor = float(truth_db.std() / predicted_db.std())
    mean_db, offset_db = float(predicted_db.mean()), float(truth_db.mean() - predicted_db.mean())
    adjusted = lambda sinr_db: mean_db + factor * (sinr_db - mean_db) + offset_db
    before, after = (_fit(values, truth_db) for values in (predicted_db, adjusted(predicted_db)))
    offset_std_db = after.rmse_db * _mean_std(measured, inside, float(simulated.attrs.get("sinr_correlation_m", CORRELATION_M)))
    # Stretched SINR is no longer that of these powers.
    result = simulated.drop_vars("rsrp_dbm", errors="ignore").copy(deep=True)
    if "sinr_spread_db" in result:
        result["sinr_spread_db"].values *= np.float32(factor)
    sinr_db = adjusted(result["sinr_db"].values.astype(np.float64))
    result["sinr_db"].values = sinr_db.astype(np.float32)
    result["sinr_std_db"].values = np.full(sinr_db.shape, after.rmse_db, np.float32)
    for name in ("fill_kernel", "fill_posterior"):  # of the uncertainty that this error replaces
        result.attrs.pop(name, None)
    result.attrs |= {
        "sinr_common_std_db": offset_std_db,
        "calibration_offset_db": offset_db,
        "calibration_spread_factor": factor,
        "calibration_mean_db": mean_db,
    }
    for when, fit in (("before", before), ("after", after)):
        result.attrs |= {f"calibration_{name}_{when}": value for name, value in fit._asdict().items()}
    return Calibration(validate(result), offset_db, offset_std_db, factor, int(inside.sum()), before, after)


def _mean_std(measured: RadioMap, used: NDArray[np.bool_], correlation_m: float) -> float:
    """Standard deviation of the mean of the measured cells that are used, for correlated errors of variance 1."""
    weight = np.zeros(measured["sinr_db"].size)
    weight[np.flatnonzero(is_measured(measured))[used]] = 1.0 / used.sum()
    return float(np.linalg.norm(along_axes(weight, transposed(axis_factors(grid_of(measured), (correlation_m,) * 3)))))


def _local_to(target: RadioMap, source: RadioMap, points_m: FloatArray) -> FloatArray:
    """Points of one map in the local metres of another."""
    to, of = anchor_of(target), anchor_of(source)
    if (to is None) != (of is None):
        raise InputError("one of the maps has an anchor and the other has none: where one lies in the other is not known")
    if to is None or of is None:
        return points_m
    x_m, y_m = to_local(*to_degrees(points_m[:, 0], points_m[:, 1], of), to)
    return np.stack([x_m, y_m, points_m[:, 2]], axis=-1)


def _look_up(radio_map: RadioMap, points_m: FloatArray) -> FloatArray:
    """SINR at points by linear interpolation between cell centres; NaN outside, and at heights the map does not reach."""
    axes = [radio_map[axis].values for axis in ("z", "y", "x")]
    values = radio_map["sinr_db"].values.astype(np.float64)
    wide = [axis if len(axis) > 1 else np.array([axis[0] - 0.5, axis[0] + 0.5]) for axis in axes]
    for dimension, axis in enumerate(axes):
        if len(axis) == 1:
            values = np.repeat(values, 2, axis=dimension)
    look_up = lambda array: RegularGridInterpolator(wide, array, bounds_error=False)(points_m[:, ::-1])
    known = np.isfinite(values)
    # An unknown cell matters only where it has weight: NaN times 0 would be NaN at the very centre of its neighbour.
    certain = look_up(known.astype(np.float64)) > 1 - 1e-9
    return np.where(certain, look_up(np.where(known, values, 0.0)), np.nan)


def _fit(predicted_db: FloatArray, truth_db: FloatArray) -> Fit:
    error_db = predicted_db - truth_db
    correlation = float(np.corrcoef(predicted_db, truth_db)[0, 1]) if truth_db.std() > 0 else np.nan
    ratio = float(predicted_db.std() / truth_db.std()) if truth_db.std() > 0 else np.inf
    return Fit(float(error_db.mean()), ratio, float(np.sqrt(np.mean(error_db**2))), correlation)
