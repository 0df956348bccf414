"""Where the map of a scenario comes from: simulated, gridded from measured logs, or read from a file."""

from pathlib import Path
from typing import Annotated, Literal

import tyro
from pydantic import Field, Strict, model_validator

from cellpilot.settings import Count, Finite, Floats, NonNegative, Pair, Paths, Positive, Settings


class SimulatedMap(Settings):
    """A map simulated after 3GPP TR 36.777 over a hexagonal deployment, or over the sectors of a site list."""

    kind: Annotated[Literal["simulated"], tyro.conf.Suppress] = "simulated"
    heights_m: Floats = Field((30.0,), description="flight heights [m], increasing (section 4.2.1: 30, or 20..100)")
    x_range_m: Pair = Field((-200.0, 200.0), description="west and east border [m] (section 4.2.1)")
    y_range_m: Pair = Field((-200.0, 200.0), description="south and north border [m] (section 4.2.1)")
    bin_m: Positive = Field(20.0, description="side of a cell [m] (section 4.2.1)")
    points_per_side: int = Field(8, ge=1, le=100, description="simulated points along each side of a cell, averaged in dB")
    environment: Literal["UMa-AV", "UMi-AV", "RMa-AV"] = Field("UMa-AV", description="3GPP TR 36.777 scenario")
    los: Literal["soft", "sampled", "los", "nlos"] = Field("soft", description="line of sight: averaged, drawn or forced")
    shadowing_seed: int | None = Field(None, ge=0, lt=2**63, description="seed of shadowing and sampled LOS; None = no shadowing")
    sites: Annotated[Path, Strict(False)] | None = Field(
        None, description="site list (CSV) instead of the hexagonal deployment below"
    )
    anchor: Pair | None = Field(None, description="LAT LON of x = y = 0 [deg]; None = the middle of the site list")
    rings: int = Field(1, ge=0, le=100, description="rings of sites around the centre site; 1 = 7 sites (Table 4.1)")
    inter_site_distance_m: Positive = Field(500.0, description="distance between sites [m] (Table 4.1)")
    boresights_deg: Floats = Field((30.0, 150.0, 270.0), description="sector boresights, counter-clockwise from east [deg]")
    base_height_m: Positive = Field(25.0, description="antenna height [m] (section 4.2.1)")
    power_dbm: float = Field(48.0, ge=-100, le=100, description="power of each sector [dBm] (Table 4.1)")
    carrier_hz: Positive = Field(2e9, description="carrier frequency [Hz] (Table 4.1)")
    bandwidth_hz: Positive = Field(10e6, description="carrier bandwidth [Hz] (Table 4.1)")
    noise_figure_db: Finite = Field(9.0, description="receiver noise figure [dB]")
    load: float = Field(1.0, ge=0, le=1, description="share of resources the interferers use (0..1)")
    antenna_elements: Count = Field(10, description="elements of the antenna column")
    antenna_spacing_wavelengths: Positive = Field(0.8, description="distance between elements [wavelengths]")
    electrical_tilt_deg: Finite = Field(7.0, description="electrical downtilt [deg]")
    mechanical_tilt_deg: Finite = Field(0.0, description="mechanical downtilt [deg]")
    array_factor_floor_db: Finite = Field(-40.0, description="null fill of the array factor [dB]")

    @model_validator(mode="after")
    def _one_deployment(self) -> "SimulatedMap":
        for name in HEXAGONAL if self.sites is not None else ():
            if getattr(self, name) != type(self).model_fields[name].default:
                raise ValueError(
                    f"{name} belongs to the hexagonal deployment, but sites come from {self.sites}: leave one of them out"
                )
        return self


HEXAGONAL = (
    "rings", "inter_site_distance_m", "boresights_deg", "base_height_m", "power_dbm", "carrier_hz", "bandwidth_hz", "load",
    "antenna_elements", "antenna_spacing_wavelengths", "electrical_tilt_deg", "mechanical_tilt_deg", "array_factor_floor_db",
)  # fmt: skip
"""Settings that a site list replaces."""


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
    trend_environment: Literal["UMa-AV", "UMi-AV", "RMa-AV"] = Field("UMa-AV", description="3GPP scenario of that simulation")
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


class MeasuredMap(LogSettings):
    """A map gridded from measured logs."""

    kind: Annotated[Literal["measured"], tyro.conf.Suppress] = "measured"


class MapFile(Settings):
    """A radio map read from a file: NetCDF, Zarr, GeoTIFF or CSV."""

    kind: Annotated[Literal["file"], tyro.conf.Suppress] = "file"
    path: Annotated[Path, Strict(False)] = Field(Path("map.nc"), description="RadioMap file (cellpilot map writes them)")


MapSettings = SimulatedMap | MeasuredMap | MapFile
