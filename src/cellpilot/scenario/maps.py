"""Where the map of a scenario comes from: simulated, gridded from measured logs, or read from a file."""

from pathlib import Path
from typing import Annotated, Literal

import tyro
from pydantic import Field, Strict, model_validator

from cellpilot.maps.settings import AreaSettings, LogSettings
from cellpilot.radio.settings import HexagonalSettings, PropagationSettings
from cellpilot.settings import Pair, Settings


class SimulatedMap(HexagonalSettings, PropagationSettings, AreaSettings):
    """A map simulated after 3GPP TR 36.777 over a hexagonal deployment, or over the sectors of a site list."""

    kind: Annotated[Literal["simulated"], tyro.conf.Suppress] = "simulated"
    sites: Annotated[Path, Strict(False)] | None = Field(None, description="site list (CSV) instead of the hexagonal deployment")
    anchor: Pair | None = Field(None, description="LAT LON of x = y = 0 [deg]; None = the middle of the site list")

    @model_validator(mode="after")
    def _one_deployment(self) -> "SimulatedMap":
        for name in OF_LAYOUT if self.sites is not None else ():
            if getattr(self, name) != type(self).model_fields[name].default:
                raise ValueError(
                    f"{name} belongs to the hexagonal deployment, but sites come from {self.sites}: leave one of them out"
                )
        return self


OF_LAYOUT = tuple(name for name in HexagonalSettings.model_fields if name != "noise_figure_db")
"""Settings that a site list replaces."""


class MeasuredMap(LogSettings):
    """A map gridded from measured logs."""

    kind: Annotated[Literal["measured"], tyro.conf.Suppress] = "measured"


class MapFile(Settings):
    """A radio map read from a file: NetCDF, Zarr, GeoTIFF or CSV."""

    kind: Annotated[Literal["file"], tyro.conf.Suppress] = "file"
    path: Annotated[Path, Strict(False)] = Field(Path("map.nc"), description="RadioMap file (cellpilot map writes them)")


MapSettings = SimulatedMap | MeasuredMap | MapFile
