"""Aiding of the tracking loops: from the antenna's motion to Doppler at uniform knots.

The antenna's position, velocity and acceleration at the knots give every satellite's carrier
Doppler and its rate exactly (`deepseis_core.propagation`): geometry with the Earth's rotation and
the satellite's clock with relativity. Atmosphere (0.01 Hz) and receiver clock are left to the
loop: both change slowly.

Knots lie on multiples of one step of about 1 ms, so those of neighbouring spans are the same
samples wherever the spans are cut. Between knots the loops interpolate with cubics; shaking of
amplitude A [Hz] at w [rad/s] leaves ``A w^4 (1 ms)^4 / 384``: 7e-8 Hz at 2 g and 10 Hz, 7e-5 Hz
at 2 g and 100 Hz.

References
----------
Thesis 4.1 to 4.5 and Doppler-aided 2.1 to 2.3, with the signs corrected as in
`deepseis_core.propagation`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepseis_core.gps_time import GpsTime
from deepseis_core.propagation import DOPPLER_HZ, DOPPLER_RATE, line_of_sight
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import Aiding, Float32Array, FloatArray, IntArray

KNOT_S = 1e-3


@dataclass(frozen=True)
class KnotGrid:
    """Knots of one span of samples: from at or before its first to at or after its end.

    Examples
    --------
    >>> grid = KnotGrid.of_span(80_000, 80_000, 4e6)
    >>> grid.first, grid.step, grid.count, grid.samples[-1].item()
    (80000, 4000, 21, 160000)
    """

    valid_from: int
    valid_through: int
    first: int
    step: int
    count: int

    @classmethod
    def of_span(cls, sample_index: int, sample_count: int, sample_rate_hz: float) -> KnotGrid:
        """Lay the knots of ``sample_count`` samples from ``sample_index`` on."""
        step = max(1, round(KNOT_S * sample_rate_hz))
        end = sample_index + sample_count
        low, high = sample_index // step, -(-end // step)
        return cls(sample_index, end - 1, low * step, step, high - low + 1)

    @property
    def samples(self) -> IntArray:
        """Sample index of every knot."""
        return self.first + self.step * np.arange(self.count, dtype=np.int64)

    def seconds(self, sample_rate_hz: float) -> FloatArray:
        """Time of every knot since sample 0 [s]."""
        return self.samples / sample_rate_hz


class DopplerPredictor:
    """Makes the aiding of some satellites from the antenna's motion.

    Parameters
    ----------
    source : str
        Who predicts: "fusion" or "truth".
    start : GpsTime
        GPS time of sample 0; 1 s of error shifts a Doppler by less than 1 Hz, all but constant.
    sample_rate_hz : float
        Of the receiver's clock [Hz].
    """

    def __init__(self, source: str, start: GpsTime, sample_rate_hz: float) -> None:
        self.source, self.start, self.sample_rate_hz = source, start, sample_rate_hz
        self._clock = SampleClock(0, sample_rate_hz)

    def gps_time(self, sample_index: int) -> GpsTime:
        """Return the GPS time of a sample."""
        return self.start.add_ns(self._clock.offset_ns(sample_index))

    def predict(
        self,
        grid: KnotGrid,
        antenna: FloatArray,
        satellites: tuple[str, ...],
        packed: FloatArray,
        *,
        clock_drift_hz: float = np.nan,
        doppler_sd_hz: Float32Array | float = 0.0,
    ) -> Aiding:
        """Return the aiding of one span.

        Parameters
        ----------
        grid : KnotGrid
            The span and its knots.
        antenna : ndarray, shape (grid.count, 9)
            ECEF position [m], velocity [m/s], acceleration [m/s^2] at the knots, each the plain
            derivative of the coordinates before.
        satellites : tuple of str, length n
            Names, in the order of ``packed``.
        packed : ndarray, shape (n, 22)
            Their ephemerides (`deepseis_core.ephemeris.pack`).
        clock_drift_hz : float, optional
            What the receiver's oscillator adds [Hz]; NaN: unknown.
        doppler_sd_hz : float or ndarray, shape (n,), optional
            One sigma [Hz].
        """
        zero = self.gps_time(grid.first)
        elapsed = [self._clock.offset_ns(k) for k in grid.samples.tolist()]
        tow_ns = zero.tow_ns + np.array(elapsed, np.int64) - elapsed[0]
        table = line_of_sight(packed, zero.week, tow_ns, antenna).table
        sd = np.broadcast_to(np.asarray(doppler_sd_hz, np.float32), (len(satellites),))
        return Aiding(
            source=self.source,
            valid_from=grid.valid_from,
            valid_through=grid.valid_through,
            valid=bool(satellites),
            knot_sample_index=grid.first,
            knot_step_samples=grid.step,
            knot_count=grid.count,
            satellites=satellites,
            carrier_doppler_hz=np.ascontiguousarray(table[:, :, DOPPLER_HZ].T),
            carrier_doppler_rate=np.ascontiguousarray(table[:, :, DOPPLER_RATE].T),
            clock_drift_hz=clock_drift_hz,
            doppler_sd_hz=sd,
        )
