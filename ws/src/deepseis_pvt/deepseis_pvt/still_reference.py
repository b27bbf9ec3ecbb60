"""Where a still antenna is: the surveyed place, and after an event where that has left it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import chdtri

from deepseis_core.config import setting
from deepseis_core.types import FloatArray

MOTION_LIMIT: Final = float(chdtri(3, 1e-9))
"""Squared normalised displacement from the reference that phases alone call motion [-]."""
OFFSET_LIMIT: Final = float(chdtri(3, 1e-2))
"""Of a displacement that stays behind: below, it cannot be told from none [-]."""
HOLE_S: Final = 1.5
"""Without displacements for longer, what was gathered before does not count: phases that come back
bring another error [s]."""
RESTLESS: Final = 2.0
"""Spread, over that of the noise, beyond which an antenna is not called still again [-]."""


@dataclass(frozen=True)
class ReferenceConfig:
    """Settings of `StillReference`."""

    hold_s: float = setting(
        1.0, "phases that show motion stop the calibration for that long [s]", low=0.02, high=60.0
    )
    settle_s: float = setting(
        10.0, "stillness after motion before calibration goes on there [s]", low=0.5, high=600.0
    )
    lost_sd: float = setting(
        0.05,
        "of a place at rest after motion in which all phases were lost [m]",
        low=0.0,
        high=10.0,
    )


class StillReference:
    """Decides whether an epoch may calibrate, and where the antenna then is.

    What others know of stillness (the motion detector, the operator) comes in; phases that leave
    the reference contradict it. After motion the antenna is taken to be still again once it has
    been called so for ``settle_s`` and its displacements scatter no more than noise; where
    they then lie is the new reference, with its covariance, unless it cannot be told from the
    old one. If all phases were lost meanwhile there are no displacements: after that time of
    stillness the old reference holds again, less certain by ``lost_sd``.

    Parameters
    ----------
    config : ReferenceConfig, optional
        Settings.
    witnessed : bool, optional
        An IMU tells of motion. Then phases that contradict it only stop the calibration for a
        while; without one they are motion.

    Attributes
    ----------
    position, covariance : ndarray, shapes (3,), (3, 3)
        East, north, up of the surveyed place [m].
    moved : bool
        There has been motion since the reference was found.
    """

    def __init__(self, config: ReferenceConfig | None = None, *, witnessed: bool = False) -> None:
        self.config = config or ReferenceConfig()
        self.witnessed = witnessed
        self.position: FloatArray = np.zeros(3)
        self.covariance: FloatArray = np.zeros((3, 3))
        self.moved, self.started = False, False
        self.counts = {
            "motions": 0, "contradicted": 0, "new_references": 0, "lost_references": 0,
        }  # fmt: skip
        self._held = -np.inf
        self._since: float | None = None
        self._last = -np.inf  # of the displacements gathered
        self._blind: float | None = None  # at rest without displacements since then
        self._rest: list[FloatArray] = []

    def decide(
        self,
        time: float,
        still: bool,
        displacement: FloatArray | None,
        covariance: FloatArray,
        common: FloatArray,
    ) -> bool:
        """Tell whether the antenna is at the reference at an epoch.

        Parameters
        ----------
        time : float
            Of the epoch [s].
        still : bool
            What is known from elsewhere.
        displacement : ndarray, shape (3,), or None
            The free solution of the epoch, against ``position`` where biases are calibrated.
        covariance, common : ndarray, shape (3, 3)
            Of it; and the part of it that stays the same for many epochs.
        """
        if not self.started:
            self.started = still
            return still
        if not still:
            self._leave()
        elif not self.moved and displacement is not None:
            away = displacement - self.position
            if away @ np.linalg.solve(covariance, away) > MOTION_LIMIT:
                self.counts["contradicted"] += 1
                self._held = time + self.config.hold_s
                if not self.witnessed:
                    self._leave()
        if self.moved and still:
            self._settle(time, displacement, covariance, common)
        return still and not self.moved and time >= self._held

    def _leave(self) -> None:
        if not self.moved:
            self.counts["motions"] += 1
        self.moved, self._since, self._blind = True, None, None
        self._rest.clear()

    def _settle(
        self,
        time: float,
        displacement: FloatArray | None,
        covariance: FloatArray,
        common: FloatArray,
    ) -> None:
        """Gather displacements at rest; adopt their mean once they have been long enough."""
        if displacement is None:
            self._wait_blindly(time)
            return
        self._blind = None
        if self._since is None or time - self._last > HOLE_S:
            self._since = time
            self._rest.clear()
        self._last = time
        self._rest.append(displacement)
        if time - self._since < self.config.settle_s:
            return
        rest = np.array(self._rest)
        noise = np.sqrt(np.maximum(np.diag(covariance - common), 1e-12))
        if (rest.std(axis=0) > RESTLESS * noise).any():
            half = len(self._rest) // 2
            del self._rest[:half]
            self._since += self.config.settle_s / 2.0
            return
        self._adopt(rest.mean(axis=0), common)

    def _wait_blindly(self, time: float) -> None:
        """Take the old reference again once the antenna has been still for long enough."""
        if self._blind is None:
            self._blind = time
        if time - self._blind < self.config.settle_s:
            return
        self.covariance = self.covariance + self.config.lost_sd**2 * np.eye(3)
        self.counts["lost_references"] += 1
        self.moved, self._since, self._blind = False, None, None
        self._rest.clear()

    def _adopt(self, mean: FloatArray, common: FloatArray) -> None:
        away, spread = mean - self.position, common + 1e-10 * np.eye(3)
        if away @ np.linalg.solve(spread, away) > OFFSET_LIMIT:
            self.position = mean
            self.covariance = self.covariance + common
            self.counts["new_references"] += 1
        self.moved, self._since = False, None
        self._rest.clear()
