"""Epochs of GNSS as the filter takes them: positions of PVT, precise ones in its axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_core.types import FloatArray, PrecisePosition, PreciseStatus, Pvt, PvtStatus

RTK: Final = "rtk"
"""Kinds of positions against a base begin with it."""


@dataclass(frozen=True)
class PreciseEpoch:
    """A precise position in the axes of the filter's measurements.

    Attributes
    ----------
    sample_index : int
    kind : str
        Method, status and datum: what has a slow error of its own.
    position_ecef, noise_ecef : ndarray, shapes (3,), (3, 3)
        Position and covariance of its noise [m, m^2].
    common_ecef : ndarray, shape (3, 3)
        Covariance of what neighbouring epochs share: biases that creep [m^2].
    clock_bias, clock_bias_sd : float
        Receiver clock times c, and sigma of its change [m].
    afloat : bool
        It is from a place that is not known, the same for all of its kind.
    """

    sample_index: int
    kind: str
    position_ecef: FloatArray
    noise_ecef: FloatArray
    common_ecef: FloatArray
    clock_bias: float
    clock_bias_sd: float
    afloat: bool = False

    @property
    def against_base(self) -> bool:
        """Whether it is of RTK."""
        return self.kind.startswith(RTK)

    @classmethod
    def of(
        cls, value: PrecisePosition, antenna_ecef: FloatArray, C_enu_e: FloatArray
    ) -> PreciseEpoch | None:
        """Turn a message's value; None where it does not say how the antenna moves.

        Parameters
        ----------
        value : PrecisePosition
        antenna_ecef : ndarray, shape (3,)
            Where the antenna was surveyed [m].
        C_enu_e : ndarray, shape (3, 3)
            Axes there.
        """
        if not (is_placed(value) or is_afloat(value)):
            return None
        common_enu = np.reshape(value.common_covariance_enu, (3, 3))
        noise_enu = np.reshape(value.covariance_enu, (3, 3)) - common_enu
        return cls(
            value.sample_index,
            f"{value.method} {int(value.status)} {value.datum}",
            antenna_ecef + value.displacement_enu @ C_enu_e,
            C_enu_e.T @ noise_enu @ C_enu_e,
            C_enu_e.T @ common_enu @ C_enu_e,
            value.clock_bias,
            value.clock_bias_sd,
            value.datum > 0,
        )


Epoch = Pvt | PreciseEpoch


def has_position(pvt: Pvt) -> bool:
    """Return whether there is a position with a covariance."""
    return pvt.status != PvtStatus.NONE and is_measured(
        pvt.position_ecef, pvt.position_covariance_ecef
    )


def has_velocity(pvt: Pvt) -> bool:
    """Return whether there is a velocity with a covariance."""
    return is_measured(pvt.velocity_ecef, pvt.velocity_covariance_ecef)


def is_placed(value: PrecisePosition) -> bool:
    """Return whether a precise position says where the antenna is, with noise of its own."""
    noise = np.reshape(value.covariance_enu, (3, 3)) - np.reshape(
        value.common_covariance_enu, (3, 3)
    )
    return value.status >= PreciseStatus.PHASE and is_measured(value.displacement_enu, noise)


def is_afloat(value: PrecisePosition) -> bool:
    """Return whether a precise position says how the antenna moves, from a place not known."""
    noise = np.reshape(value.covariance_enu, (3, 3)) - np.reshape(
        value.common_covariance_enu, (3, 3)
    )
    return value.datum > 0 and is_measured(value.displacement_enu, noise)


def is_measured(value: FloatArray, covariance: FloatArray) -> bool:
    """Return whether a value is finite and its covariance positive definite."""
    if not (np.isfinite(value).all() and np.isfinite(covariance).all()):
        return False
    return bool(np.linalg.eigvalsh(covariance)[0] > 0.0)
