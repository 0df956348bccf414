"""Settings of maps, each stated once: TOML, command line and library functions take them from here."""

from pathlib import Path
from typing import Annotated, Literal

import tyro
from pydantic import Field, Strict, model_validator

from cellpilot.radio.settings import PROPAGATION, EnvironmentName
from cellpilot.settings import Finite, Floats, NonNegative, Pair, Paths, Positive, Settings


class AreaSettings(Settings):
    """The cells of a computed map."""

    heights_m: Floats = Field((30.0,), description="flight heights [m], increasing (section 4.2.1: 30, or 20..100)")
    x_range_m: Pair = Field((-200.0, 200.0), description="west and east border [m] (section 4.2.1)")
    y_range_m: Pair = Field((-200.0, 200.0), description="south and north border [m] (section 4.2.1)")
    bin_m: Positive = Field(20.0, description="side of a cell [m] (section 4.2.1)")
    points_per_side: int = Field(8, ge=1, le=100, description="simulated points along each side of a cell, averaged in dB")


class LogSettings(Settings):
    """How measured logs become a map."""

    logs: Paths = Field((), description="log files; several files = several heights, or parts of one flight")
    altitude_m: Annotated[float | None, tyro.conf.arg(aliases=("--altitude",))] = Field(
        None, ge=0, le=10_000, description="height of the logs [m]; None = as the logs or their file names say"
    )
    ground_altitude_m: Finite | None = Field(
        None, description="altitude of height 0 [m] for logs that count from ellipsoid or sea"
    )
    height_step_m: Positive = Field(10.0, description="altitudes of a log are put on multiples of this [m]")
    columns: str | None = Field(
        None, description="columns of a log of unknown kind: lat=..,lon=..,sinr=.. and alt, rsrp, rsrq, cell, time, accuracy"
    )
    altitude_unit: Literal["m", "ft"] | None = Field(None, description="unit of the altitude column where its name does not say")
    altitude_reference: Literal["take-off", "ellipsoid", "sea-level"] | None = Field(
        None, description="what the altitude column counts from"
    )
    max_accuracy_m: Positive = Field(30.0, description="leave out samples at positions less certain than this [m]")
    max_age_s: Positive = Field(5.0, description="leave out samples at positions older than this [s]")
    bin_m: Positive = Field(40.0, description="side of a cell [m]")
    fill: Literal["inverse-distance", "gaussian-process"] = Field("inverse-distance", description="how holes are filled")
    fill_radius_m: NonNegative = Field(80.0, description="fill holes from neighbours within [m]; 0 = leave holes")
    trend: Annotated[Path, Strict(False)] | None = Field(
        None, description="site list: the Gaussian process departs from its simulation, fitted to the log"
    )
    trend_environment: EnvironmentName = Field(PROPAGATION.environment, description="3GPP scenario of that simulation")
    mask: Annotated[tuple[Finite, Finite, Finite], Strict(False)] | Literal["auto", "none"] = Field(
        "auto", description="leave out samples within LAT LON RADIUS_M; auto = the hover at take-off, if there is one"
    )
    unknown: Literal["blocked", "bad"] = Field("blocked", description="what an unknown cell is: not to be entered, or bad signal")

    @model_validator(mode="after")
    def _all_is_used(self) -> "LogSettings":
        for name in ("altitude_unit", "altitude_reference"):
            if getattr(self, name) is not None and self.columns is None:
                raise ValueError(f"{name} is for logs with named columns: name them in columns, or leave it out")
        if self.fill_radius_m == 0 and self.fill != type(self).model_fields["fill"].default:
            raise ValueError(f"fill is {self.fill}, but fill_radius_m is 0: nothing would be filled")
        if self.trend is None and self.trend_environment != type(self).model_fields["trend_environment"].default:
            raise ValueError("trend_environment is for a trend: give its site list, or leave it out")
        if self.trend is not None and self.fill != "gaussian-process":
            raise ValueError(
                f"trend is for the Gaussian process, but holes are filled by {self.fill}: set fill to gaussian-process"
            )
        return self


AREA, LOGS = AreaSettings(), LogSettings()
"""The defaults."""
