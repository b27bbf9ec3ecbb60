"""What a filter that corrects itself writes down for its smoother (`deepseis_ins.smoother`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepseis_core.types import FloatArray
from deepseis_ins.smoother import FilterStep


@dataclass(frozen=True)
class TapeState:
    """All that a tape is at a moment."""

    transition: FloatArray
    moved: bool
    open: FilterStep | None
    steps: tuple[FilterStep, ...]


class StepTape:
    """Collects the steps of a filter of n errors.

    Measurements between which nothing moves are one step: their corrections add up.

    Attributes
    ----------
    transition : ndarray, shape (n, n)
        Since the last measurement.
    moved : bool
        Whether anything has changed since then.
    """

    def __init__(self, n: int) -> None:
        self.transition = np.eye(n)
        self.moved = True
        self._open: FilterStep | None = None
        self._steps: tuple[FilterStep, ...] = ()

    def carry(self, transition: FloatArray) -> None:
        """Say that the errors have gone through a transition, shape (n, n)."""
        self.transition = transition @ self.transition
        self.moved = True

    def move(self) -> None:
        """Say that errors or their covariance have changed without a measurement."""
        self.moved = True

    def measure(self, before: FloatArray, correction: FloatArray, after: FloatArray) -> None:
        """Write a measurement down; arguments as in `FilterStep`."""
        if self._open is not None and not self.moved:
            step = self._open
            total = step.correction + correction
            self._open = FilterStep(step.transition, step.before, total, after)
            return
        self._close()
        self._open = FilterStep(self.transition, before, correction, after)
        self.transition = np.eye(len(correction))
        self.moved = False

    def take(self, P: FloatArray) -> list[FilterStep]:
        """Return the steps since the last time, the present one with covariance P included."""
        if self.moved:
            self.measure(P, np.zeros(len(P)), P)
        self._close()
        steps = list(self._steps)
        self._steps, self.moved = (), True
        return steps

    def state(self) -> TapeState:
        """Return all that the tape is."""
        return TapeState(self.transition.copy(), self.moved, self._open, self._steps)

    def restore(self, state: TapeState) -> None:
        """Be again what the tape was."""
        self.transition = state.transition.copy()
        self.moved, self._open, self._steps = state.moved, state.open, state.steps

    def _close(self) -> None:
        if self._open is not None:
            self._steps = (*self._steps, self._open)
            self._open = None
