"""Of the loosely coupled filter: settings, innovations, snapshots."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from deepseis_core.config import setting
from deepseis_core.types import FloatArray
from deepseis_ins.smoother_tape import TapeState


@dataclass(frozen=True)
class LooseConfig:
    """Settings of the loosely coupled filter."""

    covariance_step: float = setting(
        0.05, "step of the covariance's propagation [s]", low=1e-4, high=1.0
    )
    false_alarm_probability: float = setting(
        1e-5, "of a good innovation to be rejected [-]", low=0.0, high=0.1
    )
    rejections_before_recovery: int = setting(
        10, "of one kind in a row, then its states are widened and it is believed", low=1
    )


@dataclass(frozen=True)
class Innovation:
    """How a measurement agreed with what was predicted.

    Attributes
    ----------
    name : str
        Kind of the measurement.
    z, sd : ndarray, shape (3,)
        Prediction minus measurement and what it should amount to; north, east, down.
    normalised_squared : float
        ``z S^-1 z``; chi-square with three degrees of freedom if all is as modelled.
    accepted : bool
    recovered : bool
        The states had to be widened first: z, sd and the normalised square are those before.
    """

    name: str
    z: FloatArray
    sd: FloatArray
    normalised_squared: float
    accepted: bool
    recovered: bool = False


@dataclass(frozen=True)
class Snapshot:
    """All that a filter is at a moment; `LooseFilter.restore` brings it back to the bit."""

    x: FloatArray
    bias: FloatArray
    pending: FloatArray
    P: FloatArray
    U: FloatArray
    B: FloatArray
    reference_error: FloatArray
    rejected: Mapping[str, int]
    transition: FloatArray
    tape: TapeState | None
