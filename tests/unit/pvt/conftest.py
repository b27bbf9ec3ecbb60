"""Signals that several tests share; made once."""

import numpy as np
import pytest
from unit.pvt.tracked_signals import STATION, Receiver, Sky, visible

from deepseis_core.types import TrackingEpochs

Messages = dict[str, list[TrackingEpochs]]


def circle(t: float) -> np.ndarray:
    """Move on the thesis' circle: 12 cm at 2 Hz, here in the equatorial plane."""
    phase = 4 * np.pi * t
    return STATION + 0.12 * np.array([np.cos(phase), np.sin(phase), 0.0])


@pytest.fixture(scope="package")
def still() -> Messages:
    """Return 1.6 s of a still antenna without atmosphere, clock drift 0.3 ppm."""
    receiver = Receiver(Sky(), clock_drift=3e-7)
    return {name: receiver.messages(name, 1.6) for name in visible()}


@pytest.fixture(scope="package")
def moving() -> Messages:
    """Return 1.2 s of an antenna on a circle, with atmosphere."""
    receiver = Receiver(Sky(circle, atmosphere=True))
    return {name: receiver.messages(name, 1.2) for name in visible()}
