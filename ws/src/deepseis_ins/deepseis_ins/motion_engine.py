"""The motion detector on the station's clock: from IMU samples to states by sample index."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from deepseis_core.config import setting
from deepseis_core.imu_grades import ImuGrade
from deepseis_core.types import ImuSample, MotionState
from deepseis_ins.motion_state import MotionConfig, MotionDecision, MotionDetector

ABSENT = -1.0
GROUP_S = 0.02
"""Samples are worked through in groups of so many seconds."""


@dataclass(frozen=True)
class MotionEngineConfig:
    """Settings of `MotionEngine`."""

    report_s: float = setting(1.0, "the state is said again that often [s]", low=0.02, high=60.0)


class MotionEngine:
    """Feeds a detector with the samples whose time has come.

    Parameters
    ----------
    config : MotionEngineConfig
    detector : MotionConfig
        Settings of the rule.
    grade : ImuGrade
    imu_rate_hz, sample_rate_hz : float
        Rates of the IMU and of the station's clock [Hz].

    Attributes
    ----------
    valid_through : int
        Last sample whose state is decided; -1: none.
    """

    def __init__(
        self,
        config: MotionEngineConfig,
        detector: MotionConfig,
        grade: ImuGrade,
        imu_rate_hz: float,
        sample_rate_hz: float,
    ) -> None:
        self.detector = MotionDetector(detector, imu_rate_hz, grade)
        self.policy = detector.policy
        self._step = sample_rate_hz / imu_rate_hz
        self._group = max(1, round(GROUP_S * imu_rate_hz))
        self._every = max(1, round(config.report_s / GROUP_S)) * self._group
        self._next = self._group
        self._queue: list[ImuSample] = []
        self.valid_through = -1
        self.switches = 0

    def join(self, sample_index: int) -> None:
        """Begin with the first whole group at or after a sample of a running graph."""
        before = self._number_at(sample_index) - 1
        self._next = (-(-before // self._group) + 1) * self._group

    def push(self, sample: ImuSample) -> None:
        """Take an IMU sample, in order."""
        self._queue.append(sample)

    def advance(self, through: int) -> Iterator[tuple[int, list[MotionState]]]:
        """Decide group by group while all IMU samples of a group, up to ``through``, are there.

        Yields
        ------
        tuple
            Sample through which the state is decided, and what is to be said of it. Where IMU
            samples are missing the last state is taken to go on.
        """
        while self._end(self._next) <= through:
            end, self._next = self._next, self._next + self._group
            count = sum(self._number(sample) <= end for sample in self._queue)
            due, self._queue = self._queue[:count], self._queue[count:]
            said = [state for piece in self._pieces(due) for state in self._feed(piece)]
            if end % self._every == 0 and self.detector.decided_through is not None:
                said.append(self._state(self.detector.report()))
            self.valid_through = self._end(end)
            yield self.valid_through, said

    def _pieces(self, samples: list[ImuSample]) -> Iterator[list[ImuSample]]:
        """Cut samples where some are missing."""
        numbers = [self._number(sample) for sample in samples]
        cuts = [k for k in range(1, len(samples)) if numbers[k] != numbers[k - 1] + 1]
        for begin, end in pairwise([0, *cuts, len(samples)]):
            if end > begin:
                yield samples[begin:end]

    def _feed(self, samples: list[ImuSample]) -> list[MotionState]:
        force = np.array([sample.linear_acceleration for sample in samples])
        absent = samples[0].angular_velocity_variance == ABSENT
        omega = None if absent else np.array([sample.angular_velocity for sample in samples])
        decisions = self.detector.push(self._number(samples[0]), omega, force)
        self.switches += len(decisions)
        return [self._state(decision) for decision in decisions]

    def _number(self, sample: ImuSample) -> int:
        """Return a sample's number: that of the clock's first interval is 1."""
        return self._number_at(sample.sample_index)

    def _number_at(self, sample_index: int) -> int:
        return round(sample_index / self._step)

    def _end(self, number: int) -> int:
        return int(number * self._step)

    def _state(self, decision: MotionDecision) -> MotionState:
        return MotionState(
            sample_index=max(0, self._end(decision.since - 1)),
            valid_through=self._end(decision.decided),
            state=int(decision.state),
            policy=self.policy,
            variance=np.asarray(decision.variance, np.float32),
            threshold=np.asarray(decision.threshold, np.float32),
        )
