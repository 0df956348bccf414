"""Settings of the radio model, each stated once: TOML, command line and library functions take them from here."""

from typing import Literal

from pydantic import Field

from cellpilot.settings import Count, Finite, Floats, Positive, Settings

EnvironmentName = Literal["UMa-AV", "UMi-AV", "RMa-AV"]
LosMode = Literal["soft", "sampled", "los", "nlos"]


class PropagationSettings(Settings):
    """How the signal spreads (3GPP TR 36.777)."""

    environment: EnvironmentName = Field("UMa-AV", description="3GPP TR 36.777 scenario")
    los: LosMode = Field("soft", description="line of sight: averaged, drawn or forced")
    shadowing_seed: int | None = Field(None, ge=0, lt=2**63, description="seed of shadowing and sampled LOS; None = no shadowing")


class ColumnSettings(Settings):
    """A vertical column of antenna elements."""

    antenna_elements: Count = Field(10, description="elements of the antenna column")
    antenna_spacing_wavelengths: Positive = Field(0.8, description="distance between elements [wavelengths]")
    electrical_tilt_deg: Finite = Field(7.0, description="electrical downtilt [deg]")
    mechanical_tilt_deg: Finite = Field(0.0, description="mechanical downtilt [deg]")
    array_factor_floor_db: Finite = Field(-40.0, description="null fill of the array factor [dB]")


class HexagonalSettings(ColumnSettings):
    """Sites on a hexagonal lattice, all alike (Table 4.1), and the receiver's noise."""

    rings: int = Field(1, ge=0, le=100, description="rings of sites around the centre site; 1 = 7 sites (Table 4.1)")
    inter_site_distance_m: Positive = Field(500.0, description="distance between sites [m] (Table 4.1)")
    boresights_deg: Floats = Field((30.0, 150.0, 270.0), description="sector boresights, counter-clockwise from east [deg]")
    base_height_m: Positive = Field(25.0, description="antenna height [m] (section 4.2.1)")
    power_dbm: float = Field(48.0, ge=-100, le=100, description="power of each sector [dBm] (Table 4.1)")
    carrier_hz: Positive = Field(2e9, description="carrier frequency [Hz] (Table 4.1)")
    bandwidth_hz: Positive = Field(10e6, description="carrier bandwidth [Hz] (Table 4.1)")
    noise_figure_db: Finite = Field(9.0, description="receiver noise figure [dB]")
    load: float = Field(1.0, ge=0, le=1, description="share of resources the interferers use (0..1)")


PROPAGATION, COLUMN, HEXAGONAL = PropagationSettings(), ColumnSettings(), HexagonalSettings()
"""The defaults."""
