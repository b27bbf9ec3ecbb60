"""From observations to the ranges that the tightly coupled filter takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deepseis_core.constants import L1_WAVELENGTH, NS_PER_S
from deepseis_core.ephemeris import states_from_pseudoranges
from deepseis_core.hatch import HatchConfig, HatchFilter
from deepseis_core.loop_noise import lone_rate_sd
from deepseis_core.selection import select
from deepseis_core.types import FloatArray, Observations
from deepseis_ins.range_config import RangeConfig
from deepseis_ins.satellite_book import Chosen
from deepseis_ins.tight import Ranges

NOMINAL_DBHZ = 45.0
"""C/N0 to which the settings of noise refer [dB-Hz]."""


@dataclass(frozen=True)
class RangeEpoch:
    """An epoch of ranges.

    Attributes
    ----------
    sample_index : int
    satellites : tuple of str, length n
    ranges : Ranges
        With sigmas of noise alone.
    """

    sample_index: int
    satellites: tuple[str, ...]
    ranges: Ranges


class RangeBuilder:
    """Smooths and selects, epoch by epoch, in order.

    Parameters
    ----------
    config : RangeConfig
    up_ecef : ndarray, shape (3,)
        The vertical at the station.

    Attributes
    ----------
    dropped : int
        Epochs that came after later ones: an arc of smoothing cannot go back.
    """

    def __init__(self, config: RangeConfig, up_ecef: FloatArray) -> None:
        self.config, self.up_ecef = config, up_ecef
        self.klobuchar: FloatArray | None = None
        self._hatch: HatchFilter | None = None
        self._last, self.dropped = -1, 0

    def take(self, observations: Observations, chosen: Chosen) -> RangeEpoch | None:
        """Take an epoch; return its ranges if it is one of those to be used.

        Parameters
        ----------
        observations : Observations
        chosen : Chosen
            Satellites with ephemerides.
        """
        if observations.sample_index <= self._last:
            self.dropped += 1
            return None
        self._last = observations.sample_index
        noise = self._noise(observations)
        ranges, variance = self._smoothed(observations, noise)
        period_ns = round(NS_PER_S / self.config.ranges_hz)
        if observations.tow_ns % period_ns >= round(NS_PER_S * observations.interval):
            return None
        at = {name: k for k, name in enumerate(chosen.names)}
        known = [k for k, name in enumerate(observations.satellites) if name in at]
        known = [k for k in known if np.isfinite(ranges[k])]
        rows = np.array([at[observations.satellites[k]] for k in known], np.int64)
        seen = np.array(known, np.int64)[self._selected(chosen.unit[rows])]
        if not seen.size:
            return None
        names = tuple(observations.satellites[k] for k in seen)
        packed = chosen.packed[[at[name] for name in names]]
        amplitude = np.maximum(noise / self.config.range_sd, 1e-3)
        rate_sd = np.hypot(self.config.range_rate_sd * amplitude, lone_rate_sd(observations))
        return RangeEpoch(
            observations.sample_index,
            names,
            Ranges(
                states_from_pseudoranges(
                    packed, observations.week, observations.tow_ns, observations.pseudorange[seen]
                ),
                ranges[seen],
                -L1_WAVELENGTH * observations.carrier_doppler_hz[seen],
                np.sqrt(variance[seen]),
                rate_sd[seen],
                observations.tow_ns / NS_PER_S,
                self.klobuchar,
            ),
        )

    def _noise(self, observations: Observations) -> FloatArray:
        """Return the code's noise by its C/N0, shape (n,) [m]."""
        below = NOMINAL_DBHZ - observations.cn0_dbhz.astype(np.float64)
        below = np.nan_to_num(below, nan=0.0)
        return self.config.range_sd * 10.0 ** (below / 20.0)

    def _smoothed(
        self, observations: Observations, noise: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return ranges and the variance to be used for them."""
        variance = noise**2 + self.config.range_floor_sd**2
        if not self.config.smooth_ranges:
            return observations.pseudorange, variance
        if self._hatch is None:
            window = max(1, round(self.config.smoothing_s / observations.interval))
            self._hatch = HatchFilter(HatchConfig(window=window))
        got = self._hatch.smooth(observations, np.sqrt(variance))
        # Epochs of a grid finer than the noise's correlation tell no more than one of that time.
        alone = max(1.0, 2.0 * self.config.range_correlation_s / observations.interval)
        left = np.maximum(alone / np.maximum(got.count, 1), self.config.smoothed_share)
        return got.pseudorange, variance * np.minimum(left, 1.0)

    def _selected(self, unit: FloatArray) -> NDArray[np.bool_]:
        """Tell which of n satellites are used; unit vectors from them, ECEF, shape (n, 3)."""
        config = self.config
        elevation = np.arcsin(np.clip(-unit @ self.up_ecef, -1.0, 1.0))
        found = select(
            unit[None], elevation[None], config.range_selection, mask_deg=config.range_mask_deg
        )
        return found.chosen[0]
