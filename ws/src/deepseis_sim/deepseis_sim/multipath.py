"""A signal's second way to the antenna: one mirror reflection off the ground or a wall.

A plane at distance d behind the antenna in the direction w mirrors the antenna into a point 2 d
further on. A satellite in the direction u, in front of the plane, reaches that point later by the
way ::

    dL = -2 d u.w        ground: 2 h sin(el);  wall: 2 d cos(el) cos(az - az_wall - pi)

The plane keeps its place beside the antenna, wherever that goes. The reflection carries the code
and the data of the direct signal, dL later, and its carrier is turned by half a cycle: phase
``phi - dL / lambda + 1/2``. Where the direct signal is blocked, so is the reflected one.

To a correlator whose replica is at delay 0 a reflection of relative amplitude a looks like ::

    R(0) + a R(dL) exp(j theta),   phase error = atan2(a r sin(theta), 1 + a r cos(theta))

with theta its phase against the direct signal, r = R(dL) / R(0), R the code's autocorrelation
(Kaplan and Hegarty, "Understanding GPS", 2nd ed., section 6.2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_core.config import setting
from deepseis_core.types import FloatArray

HALF_CYCLE: Final = 0.5
"""Turn of the carrier at the mirror [cycles]."""


@dataclass(frozen=True)
class MultipathConfig:
    """Settings of the mirror."""

    reflector: str = setting("ground", "what reflects", choices=("ground", "wall"))
    distance: float = setting(
        2.0, "antenna above the ground, or before the wall [m]", low=0.0, high=1e4
    )
    azimuth_deg: float = setting(
        0.0, "direction from the antenna to the wall [deg]", low=-360.0, high=360.0
    )
    amplitude: float = setting(0.3, "of the reflection, of the direct one's", low=0.0, high=1.0)
    satellites: tuple[str, ...] = setting((), "satellites concerned; empty: all")

    def concerns(self, satellite: str) -> bool:
        """Tell whether a satellite is reflected."""
        return not self.satellites or satellite in self.satellites

    def extra_path(self, elevation: FloatArray, azimuth: FloatArray) -> FloatArray:
        """Return how much longer the reflected way is [m], for directions [rad].

        Negative for a satellite behind the plane: it has no reflection.
        """
        if self.reflector == "ground":
            return 2.0 * self.distance * np.sin(elevation)
        turn = azimuth - np.deg2rad(self.azimuth_deg)
        return -2.0 * self.distance * np.cos(elevation) * np.cos(turn)

    @property
    def gain_db(self) -> float:
        """Power of the reflection against the direct signal [dB]."""
        return float(20.0 * np.log10(self.amplitude)) if self.amplitude > 0.0 else -np.inf


def composite_phase_error(amplitude: float, turn_cycles: FloatArray) -> FloatArray:
    """Return the carrier phase error of a direct signal and a reflection [cycles].

    Parameters
    ----------
    amplitude : float
        Of the reflection in the correlator, of the direct signal's: with the code's correlation.
    turn_cycles : ndarray
        Phase of the reflection against the direct signal [cycles].

    Examples
    --------
    >>> float(composite_phase_error(0.5, np.array(0.0)))
    0.0
    """
    theta = 2.0 * np.pi * np.asarray(turn_cycles)
    error = np.arctan2(amplitude * np.sin(theta), 1.0 + amplitude * np.cos(theta))
    return error / (2.0 * np.pi)
