"""Spatially correlated Gaussian fields over the horizontal plane: shadow fading and the LOS state of every site.

A field is a finite sum of plane waves (random Fourier features), so its value is a function of seed and place alone:
whoever asks, for whatever other points, in whatever order, reads the same map. Frequencies are drawn from the spectral
density of exp(-r/d) in the plane, which is proportional to (1 + (d w)^2)^(-3/2), so the covariance over seeds is exactly
exponential. With Gaussian amplitudes of sine and cosine every single value is exactly standard normal.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellpilot.errors import InputError
from cellpilot.radio.environment import Environment
from cellpilot.radio.ranges import FloatArray, check_range

N_FEATURES = 512
"""Plane waves per field. Within one seed the correlation departs from exp(-r/d) by about 1/sqrt(2 N) = 0.03 at most."""

SITE_CORRELATION = 0.5
"""Correlation of shadowing between sites: TR 36.814 Annex A.2.1.1 (TR 38.901 takes 0)."""

FIELD_KINDS = ("los", "nlos", "state")
"""Order fixes the random streams; append only."""


@dataclass(frozen=True, eq=False)
class CorrelatedFields:
    """Standard normal fields, one for each site, as sums of shared plane waves with own amplitudes."""

    frequency_rad_m: FloatArray
    """Wave vectors `[2, feature]` [rad/m]."""
    amplitude: FloatArray
    """Amplitudes `[site, 2 * feature]`: of the cosines, then of the sines."""

    def at(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Values `[site, point]`, mean 0 and variance 1, at points `[point]` [m]."""
        phase = np.stack([x_m, y_m], axis=-1) @ self.frequency_rad_m
        return np.asarray(self.amplitude @ np.concatenate([np.cos(phase), np.sin(phase)], axis=-1).T)


@dataclass(frozen=True, eq=False)
class Shadowing:
    """The three sets of fields of one seed: shadowing under LOS, under NLOS, and the LOS state."""

    los: CorrelatedFields
    nlos: CorrelatedFields
    state: CorrelatedFields


def draw_shadowing(
    seed: int, model: Environment, site: NDArray[np.int64], site_correlation: float = SITE_CORRELATION
) -> Shadowing:
    """Fields for links to `site [link]` in an environment; rows of equal site number are equal.

    Shadowing correlates by `site_correlation` (0..1, `RangeError` outside) between sites, the LOS state is drawn for each
    site on its own. A site's field depends on seed and site number, not on which other sites exist. `InputError` for a
    seed that is not a whole number, 0 or more.

    Source: TR 38.901 clauses 7.4.4 (exponential correlation) and 7.6.3.3 (LOS state); TR 36.814 (between sites).
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"shadowing seed is {seed!r}; expected a whole number, 0 or more")
    check_range(site_correlation, "site correlation", 0.0, 1.0, "")
    return Shadowing(
        los=_draw_fields(seed, "los", site, model.correlation_los_m, site_correlation),
        nlos=_draw_fields(seed, "nlos", site, model.correlation_nlos_m, site_correlation),
        state=_draw_fields(seed, "state", site, model.correlation_state_m, 0.0),
    )


def _draw_fields(
    seed: int, kind: str, site: NDArray[np.int64], correlation_m: float, site_correlation: float
) -> CorrelatedFields:
    def generator(stream: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(int(seed), spawn_key=(FIELD_KINDS.index(kind), stream)))

    # Streams: 0 the waves, 1 the part common to all sites, 2 + n the part of site n.
    waves = generator(0)
    # The radius has the distribution function 1 - (1 + (d w)^2)^(-1/2); one draw in each of N equal slices of it keeps the
    # expectation and takes most of the chance out of a single map's correlation.
    slices = (np.arange(N_FEATURES) + 1.0 - waves.random(N_FEATURES)) / N_FEATURES
    radius = np.sqrt(slices**-2 - 1.0) / correlation_m
    angle = 2.0 * np.pi * waves.random(N_FEATURES)
    frequency = radius * np.stack([np.cos(angle), np.sin(angle)])

    scale = N_FEATURES**-0.5
    common = generator(1).normal(scale=scale, size=2 * N_FEATURES)
    numbers, row = np.unique(site, return_inverse=True)
    own = np.stack([generator(2 + int(number)).normal(scale=scale, size=2 * N_FEATURES) for number in numbers])
    amplitude = np.sqrt(site_correlation) * common + np.sqrt(1.0 - site_correlation) * own
    return CorrelatedFields(frequency, amplitude[row.reshape(-1)])
