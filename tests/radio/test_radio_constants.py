"""Every constant of the three environments against the numbers of the standard, written down here and nowhere else.

3GPP TR 36.777 Tables B-1 (LOS probability), B-2 (path loss), B-3 (shadowing); below the aerial heights 3GPP TR 38.901
Tables 7.4.2-1, 7.4.1-1, and for correlation distances Tables 7.5-6 and 7.6.3.1-2.
"""

from math import exp, log10, pi

import numpy as np
import pytest

from cellpilot.radio import ENVIRONMENTS, los_probability, path_loss_db, shadow_std_db

CORRELATION_M = {"UMa-AV": (37.0, 50.0, 50.0), "UMi-AV": (10.0, 13.0, 50.0), "RMa-AV": (37.0, 120.0, 60.0)}
"""Shadowing in line of sight, shadowing without, LOS state."""
MAST_M = {"UMa-AV": 25.0, "UMi-AV": 10.0, "RMa-AV": 35.0}
DISTANCES_M = (5.0, 17.0, 19.0, 60.0, 150.0, 400.0, 1000.0, 2500.0, 4900.0)


def decay(d: float, d1: float, p1: float) -> float:
    return 1.0 if d <= d1 else d1 / d + exp(-d / p1) * (1 - d1 / d)


def uma_probability(d: float, h: float) -> float:
    if h > 100:
        return 1.0
    if h > 22.5:
        return decay(d, max(460 * log10(h) - 700, 18), 4300 * log10(h) - 3800)
    if d <= 18:
        return 1.0
    above = 0.0 if h <= 13 else ((h - 13) / 10) ** 1.5
    return min((18 / d + exp(-d / 63) * (1 - 18 / d)) * (1 + above * 5 / 4 * (d / 100) ** 3 * exp(-d / 150)), 1.0)


def umi_probability(d: float, h: float) -> float:
    return decay(d, max(294.05 * log10(h) - 432.94, 18), 233.98 * log10(h) - 0.95) if h > 22.5 else decay(d, 18, 36)


def rma_probability(d: float, h: float) -> float:
    if h > 40:
        return 1.0
    if h > 10:
        return decay(d, max(1350.8 * log10(h) - 1602, 18), max(15021 * log10(h) - 16053, 1000))
    return 1.0 if d <= 10 else exp(-(d - 10) / 1000)


def ground_los(d2: float, d3: float, base: float, h: float, fc: float, first: float, slope: float, far: float) -> float:
    brk = 4 * (base - 1) * (h - 1) * fc * 1e9 / 3e8
    if d2 <= brk:
        return first + slope * log10(d3) + 20 * log10(fc)
    return first + 40 * log10(d3) + 20 * log10(fc) - far * log10(brk**2 + (base - h) ** 2)


def uma_loss(d2: float, d3: float, base: float, h: float, fc: float) -> tuple[float, float | None]:
    if h > 22.5:
        los = 28 + 22 * log10(d3) + 20 * log10(fc)
        return los, (-17.5 + (46 - 7 * log10(h)) * log10(d3) + 20 * log10(40 * pi * fc / 3)) if h <= 100 else None
    los = ground_los(d2, d3, base, h, fc, 28.0, 22.0, 9.0)
    return los, max(los, 13.54 + 39.08 * log10(d3) + 20 * log10(fc) - 0.6 * (h - 1.5))


def umi_loss(d2: float, d3: float, base: float, h: float, fc: float) -> tuple[float, float | None]:
    if h > 22.5:
        free = 20 * log10(40 * pi * d3 * fc / 3)
        los = max(free, 30.9 + (22.25 - 0.5 * log10(h)) * log10(d3) + 20 * log10(fc))
        return los, max(los, 32.4 + (43.2 - 7.6 * log10(h)) * log10(d3) + 20 * log10(fc))
    los = ground_los(d2, d3, base, h, fc, 32.4, 21.0, 9.5)
    return los, max(los, 35.3 * log10(d3) + 22.4 + 21.3 * log10(fc) - 0.3 * (h - 1.5))


def rma_loss(d2: float, d3: float, base: float, h: float, fc: float) -> tuple[float, float | None]:
    if h > 10:
        los = max(23.9 - 1.8 * log10(h), 20) * log10(d3) + 20 * log10(40 * pi * fc / 3)
        return los, max(los, -12 + (35 - 5.3 * log10(h)) * log10(d3) + 20 * log10(40 * pi * fc / 3))

    def near(d: float) -> float:
        building = min(0.03 * 5**1.72, 10) * log10(d) - min(0.044 * 5**1.72, 14.77) + 0.002 * log10(5) * d
        return 20 * log10(40 * pi * d * fc / 3) + building

    brk = 2 * pi * base * h * fc * 1e9 / 3e8
    los = near(d3) if d2 <= brk else near(brk) + 40 * log10(d3 / brk)
    nlos = 161.04 - 7.1 * log10(20) + 7.5 * log10(5) - (24.37 - 3.7 * (5 / base) ** 2) * log10(base)
    nlos += (43.42 - 3.1 * log10(base)) * (log10(d3) - 3) + 20 * log10(fc) - (3.2 * log10(11.75 * h) ** 2 - 4.97)
    return los, max(los, nlos)


def rma_std(d2: float, h: float, fc: float) -> tuple[float, float | None]:
    if h <= 10:
        return (4.0 if d2 < 2 * pi * 35 * h * fc * 1e9 / 3e8 else 6.0), 8.0
    return 4.2 * exp(-0.0046 * h), 6.0 if h <= 40 else None


PROBABILITY = {"UMa-AV": uma_probability, "UMi-AV": umi_probability, "RMa-AV": rma_probability}
LOSS = {"UMa-AV": uma_loss, "UMi-AV": umi_loss, "RMa-AV": rma_loss}
SPREAD = {
    "UMa-AV": lambda d, h, fc: (4.0 if h <= 22.5 else 4.64 * exp(-0.0066 * h), 6.0 if h <= 100 else None),
    "UMi-AV": lambda d, h, fc: (4.0, 7.82) if h <= 22.5 else (max(5 * exp(-0.01 * h), 2), 8.0),
    "RMa-AV": rma_std,
}


def test_the_table_has_every_environment() -> None:
    assert ENVIRONMENTS.keys() == CORRELATION_M.keys()


@pytest.mark.parametrize("name", CORRELATION_M)
def test_correlation_distances(name: str) -> None:
    model = ENVIRONMENTS[name]
    assert (model.correlation_los_m, model.correlation_nlos_m, model.correlation_state_m) == CORRELATION_M[name]


@pytest.mark.parametrize("name", CORRELATION_M)
@pytest.mark.parametrize("height_m", [1.5, 5.0, 10.0, 10.1, 14.0, 20.0, 22.5, 22.6, 40.0, 40.1, 60.0, 100.0, 100.1, 120.0, 300.0])
def test_formulas(name: str, height_m: float) -> None:
    base_m = MAST_M[name]
    for distance_m in DISTANCES_M:
        assert los_probability(name, distance_m, height_m) == pytest.approx(PROBABILITY[name](distance_m, height_m), abs=1e-9)
        distance_3d_m = float(np.hypot(distance_m, base_m - height_m))
        for carrier_ghz in (0.8, 2.0, 3.5):
            link = (name, carrier_ghz * 1e9, distance_m, base_m, height_m)
            for found, expected in (
                (path_loss_db(*link), LOSS[name](distance_m, distance_3d_m, base_m, height_m, carrier_ghz)),
                (shadow_std_db(*link), SPREAD[name](distance_m, height_m, carrier_ghz)),
            ):
                for value, wanted in zip(found, expected, strict=True):
                    assert value == pytest.approx(np.nan if wanted is None else wanted, abs=1e-6, nan_ok=True)
