"""Slow errors of satellites' ranges, or range rates, learnt while the station stands still.

Where the antenna is known, a range tells the receiver's clock and the satellite's own error:
atmosphere, orbit, satellite clock, smoothed code noise. The clock is common to all. It is left
open here, so that what is learnt are the differences between satellites; their mean stays what it
was (nothing), and whoever takes the errors off has it in his clock.

The errors walk at random. A filter that takes errors of epochs as independent is told a variance
of what is unknown of them so much larger that a second of data weighs no more than it should
(`gnss_offset.inflation`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from deepseis_core.types import FloatArray, IntArray
from deepseis_ins.gnss_offset import inflation

_CLOCK_VARIANCE = 1e6
"""Of the clock, after the mean has been taken off: open."""
_GATE = 40.0
"""Of a normalised square: what exceeds it changes nothing."""


def _nobody() -> FloatArray:
    return np.zeros(0)


def _nothing() -> FloatArray:
    return np.zeros((0, 0))


@dataclass(frozen=True)
class SatelliteErrors:
    """Errors of n satellites: means and covariance (frozen, so that undoing is easy).

    Parameters
    ----------
    prior_sd : float
        Of an error before anything has been measured.
    growth : float
        Random walk [SI/sqrt(s)].
    correlation_s, common_s : float
        Correlation time of noise; what is unknown of an error stays the same over this [s].
    names : tuple of str
    mean, covariance : ndarray, shapes (n,), (n, n)
        Measured less predicted [m or m/s].
    seconds : float
        When that was true [s].
    """

    prior_sd: float
    growth: float
    correlation_s: float
    common_s: float
    names: tuple[str, ...] = ()
    mean: FloatArray = field(default_factory=_nobody)
    covariance: FloatArray = field(default_factory=_nothing)
    seconds: float = 0.0

    def learn(
        self,
        seconds: float,
        names: tuple[str, ...],
        off: FloatArray,
        variance: FloatArray,
        dt: float,
    ) -> SatelliteErrors:
        """Return what is known after an epoch.

        Parameters
        ----------
        seconds : float
            Time of it [s].
        names : tuple of str, length k
        off : ndarray, shape (k,)
            Measured less predicted, whatever the clock; NaN: not measured.
        variance : ndarray, shape (k,)
            Of noise.
        dt : float
            Time between epochs [s].
        """
        good = np.isfinite(off)
        if np.count_nonzero(good) < 2:
            return self
        kept = tuple(name for name, there in zip(names, good, strict=True) if there)
        known = self._with(kept)
        P, rows = known.covariance_at(seconds), known._rows(kept)
        R = inflation(self.correlation_s, dt) * variance[good]
        z = off[good] - known.mean[rows]
        weight = 1.0 / (np.diag(P)[rows] + R)
        z = z - float(np.median(z))
        agrees = z**2 <= _GATE * (1.0 / weight + variance[good])
        rows, R, z = rows[agrees], R[agrees], z[agrees]
        if rows.size < 2:
            return self
        z = z - float(weight[agrees] @ z / weight[agrees].sum())
        S = P[np.ix_(rows, rows)] + np.diag(R) + _CLOCK_VARIANCE
        gain = np.linalg.solve(S, P[rows]).T
        P = P - gain @ P[rows]
        return replace(
            known, mean=known.mean + gain @ z, covariance=0.5 * (P + P.T), seconds=seconds
        )

    def of(
        self, seconds: float, names: tuple[str, ...], dt: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return errors of satellites, and the variance to be reckoned with, shapes (k,).

        The variance is that of differences from the mean of those that have been learnt: what is
        common to them is in the clock.
        """
        known = self._with(names)
        rows = known._rows(names)
        P = known.covariance_at(seconds)
        share = np.zeros(len(P))
        share[: len(self.names) or len(P)] = 1.0
        for _ in range(2):  # about the mean of those learnt, then of the better known among them
            A = np.eye(len(P)) - share / share.sum()
            variance = np.einsum("ij,jk,ik->i", A, P, A)
            share = (share > 0.0) / np.maximum(variance, 1e-12)
        A = (np.eye(len(P)) - share / share.sum())[rows]
        variance = np.einsum("ij,jk,ik->i", A, P, A)
        return known.mean[rows], inflation(self.common_s, dt) * variance

    def covariance_at(self, seconds: float) -> FloatArray:
        """Return the covariance at a time."""
        elapsed = max(seconds - self.seconds, 0.0)
        return self.covariance + self.growth**2 * elapsed * np.eye(len(self.names))

    def _rows(self, names: tuple[str, ...]) -> IntArray:
        return np.array([self.names.index(name) for name in names], np.int64)

    def _with(self, names: tuple[str, ...]) -> SatelliteErrors:
        """Return the same with satellites that had not been seen."""
        new = tuple(name for name in names if name not in self.names)
        if not new:
            return self
        n, k = len(self.names), len(new)
        covariance = np.zeros((n + k, n + k))
        covariance[:n, :n] = self.covariance
        covariance[n:, n:] = self.prior_sd**2 * np.eye(k)
        return replace(
            self,
            names=self.names + new,
            mean=np.concatenate([self.mean, np.zeros(k)]),
            covariance=covariance,
        )
