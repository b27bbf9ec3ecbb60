"""The runs that the acceptance without gyroscopes is about: one earthquake, many stations.

The motion and what the IMU ideally measures of it are made once by the bench; every run draws
errors of its own, as the bench does for a seed. The filters are linear: their errors do not
depend on the motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_core.imu_errors import ImuErrors
from deepseis_core.imu_grades import grade_named
from deepseis_core.types import FloatArray, MotionKind
from deepseis_ins.gyrofree import GyroFreeConfig, GyroFreeFilter
from deepseis_ins.gyrofree_limits import GnssErrors
from deepseis_ins.gyrofree_model import POS
from deepseis_ins.gyrofree_offline import StationRecord, Track, track
from deepseis_ins.motion_state import MotionConfig, MotionDetector
from deepseis_sim.bench import Bench
from deepseis_sim.imu import ImuSynthesizer
from deepseis_sim.position_errors import PositionErrorConfig, PositionErrors
from deepseis_sim.scenario import Scenario

CONVERGED_S: Final = 200.0
"""The paper counts from there [s]."""
START_S: Final = 3.0
"""A motion found earlier is the detector's own beginning [s]."""
LOOKS_HZ: Final = 10.0
"""How often errors are looked at; a multiple of the rate of GNSS."""
MARGIN_S: Final = 0.1
"""Before the onset found, over which stillness is not claimed [s]."""
START_POSITION_SD: Final = 0.05
"""Of the displacement where nothing says that the ground is still [m]: GNSS alone tells it."""


@dataclass(frozen=True)
class Way:
    """How a record worked through in one way erred.

    Attributes
    ----------
    forward, smoothed : ndarray, shape (n, 3)
        Errors of the displacement at `Stations.time` [m].
    P_forward, P_smoothed : ndarray, shape (k, 3, 3)
        Its covariances at the epochs of GNSS [m^2].
    """

    forward: FloatArray
    smoothed: FloatArray
    P_forward: FloatArray
    P_smoothed: FloatArray

    def error(self, kind: str) -> FloatArray:
        """Return the errors of ``forward`` or ``smoothed``."""
        return self.smoothed if kind == "smoothed" else self.forward

    def P(self, kind: str) -> FloatArray:  # noqa: N802
        """Return the covariances of ``forward`` or ``smoothed``."""
        return self.P_smoothed if kind == "smoothed" else self.P_forward


@dataclass(frozen=True)
class Ways:
    """One run of one station, worked through in every way.

    Attributes
    ----------
    gnss, drift : ndarray, shape (k, 3)
        Errors of its positions, and the slow part of them [m].
    nine, twelve, held : Way
        GNSS errors for white (the paper); drift modelled; and the ground known to be still until
        it moved.
    onset : float
        Where, by the motion detector, the motion can have begun [s].
    noticed : float
        When it decided so [s].
    """

    gnss: FloatArray
    drift: FloatArray
    nine: Way
    twelve: Way
    held: Way
    onset: float
    noticed: float


class Stations:
    """The scenario, and stations under it.

    Parameters
    ----------
    scenario : Scenario
        With accelerometers and positions.

    Attributes
    ----------
    time : ndarray, shape (n,)
        When errors are looked at: ten times a second, at ends of intervals of the IMU [s].
    truth : ndarray, shape (n, 3)
        Displacement then, east, north, up [m].
    epochs : ndarray of int, shape (k,)
        Increments before each position of GNSS.
    at_epochs : ndarray, shape (k, 3)
        Displacement at these [m].
    moving : tuple of float
        Beginning and end of the motion [s].
    """

    def __init__(self, scenario: Scenario) -> None:
        bench = Bench(scenario)
        assert scenario.imu is not None
        self.grade, self.rate_hz = grade_named(scenario.imu.grade), scenario.imu.rate_hz
        self.gnss: PositionErrorConfig = scenario.positions or PositionErrorConfig()
        self.gnss_hz, self.duration = scenario.position_rate_hz, scenario.duration
        self.latitude, _, self.height = scenario.place.geodetic
        synthesizer = ImuSynthesizer(bench.motion, bench.site, self.rate_hz, clock=bench.clock)
        count = round(self.duration * self.rate_hz)
        self.ideal = synthesizer.increments(0, count)
        self.C_enu_b = np.reshape(bench.motion.at(np.zeros(1)).C_enu_b, (-1, 3, 3))[0]
        step = round(self.rate_hz / self.gnss_hz)
        self.epochs = np.arange(0, count, step, dtype=np.int64)
        self.every = round(self.rate_hz / LOOKS_HZ)
        self.time = self.ideal.time_end[self.every - 1 :: self.every]
        at = self.epochs / self.rate_hz
        self.truth = bench.motion.at(self.time - bench.clock(self.time)).position
        self.at_epochs = bench.motion.at(at - bench.clock(at)).position
        begin, end = bench.motion.span
        self.moving = (begin, min(end, self.duration))

    @property
    def settled(self) -> tuple[float, float]:
        """What the paper counts; in the short form the motion only [s]."""
        return (CONVERGED_S if self.moving[0] > CONVERGED_S else self.moving[0], self.duration)

    def errors_of_axis(self, axis: int) -> GnssErrors:
        """Return the errors of GNSS along an axis as the limits want them."""
        g = self.gnss
        return GnssErrors(
            g.white_sd[axis], g.drift_sd[axis], g.correlation_time[axis], self.gnss_hz
        )

    def run(self, seed: int) -> Ways:
        """Draw the errors of a station and work through its record in every way."""
        unit = ImuErrors(self.grade, self.rate_hz, seed)
        measured = unit.apply(0, self.ideal.delta_theta, self.ideal.delta_vel).delta_vel
        errors = PositionErrors(self.gnss, self.gnss_hz, seed)
        gnss, drift = errors(0, len(self.epochs)), errors.drift(0, len(self.epochs))
        white, slow = np.diag(np.square(self.gnss.white_sd)), np.square(self.gnss.drift_sd)
        onset, noticed = self._onset(measured)

        def work(covariance: FloatArray, still_until: float, **settings: object) -> Way:
            config = GyroFreeConfig(**settings)  # type: ignore[arg-type]
            filter_ = GyroFreeFilter(
                config, self.grade, self.C_enu_b, latitude=self.latitude, height=self.height,
                smoothing=True,
            )  # fmt: skip
            positions = self.at_epochs + gnss
            record = StationRecord(
                measured, self.rate_hz, self.epochs, positions, covariance, still_until
            )
            return self._errors(track(filter_, record))

        modelled = {
            "drift_sd": self.gnss.drift_sd,
            "drift_correlation_time": self.gnss.correlation_time,
            "position_sd": START_POSITION_SD,
        }
        return Ways(
            gnss,
            drift,
            work(white + np.diag(slow), 0.0, position_sd=START_POSITION_SD),
            work(white, 0.0, **modelled),
            work(white, onset - MARGIN_S, **modelled),
            onset,
            noticed,
        )

    def looks_at(self, epoch: int) -> int:
        """Return the index of `time` at an epoch of GNSS, by its number from 1."""
        return int(self.epochs[epoch]) // self.every - 1

    def _errors(self, got: Track) -> Way:
        looks = slice(self.every - 1, None, self.every)
        return Way(
            got.forward.position[looks] - self.truth,
            got.smoothed.position[looks] - self.truth,
            np.array([step.after[POS, POS] for step in got.steps]),
            got.smoothed_errors.P[:, POS, POS].copy(),
        )

    def _onset(self, delta_vel: FloatArray) -> tuple[float, float]:
        """Return from where the detector, told the grade, sees motion, and when it did [s]."""
        detector = MotionDetector(MotionConfig(), self.rate_hz, self.grade)
        for decision in detector.push(0, None, delta_vel * self.rate_hz):
            noticed = (decision.decided + 1) / self.rate_hz
            if decision.state == MotionKind.MOVING and noticed > START_S:
                return decision.since / self.rate_hz, noticed
        return self.duration, self.duration
