"""A real car through a real town, tightly coupled, against its maker's own INS/GNSS."""

import numpy as np
import pytest

from deepseis_bringup.accept.tight_flight import MASK_DEG, RAW_ALL, fly, rms, without
from deepseis_bringup.accept.tight_real import kingston
from deepseis_bringup.accept.tight_rtklib import rtklib_positions

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def drive(shared_data):
    return kingston(shared_data / "gnss_ins").until(1200.0)


def test_it_is_nearer_to_the_reference_than_single_points(drive):
    """Ten minutes of driving after ten at rest: metres, and less than RTKLIB's."""
    flight = fly(drive, RAW_ALL)
    peer = drive.errors_n(rtklib_positions(drive, MASK_DEG))
    both = np.isfinite(flight.error[:, 0]) & np.isfinite(peer[:, 0])
    ours, theirs = (np.hypot(*rms(e[both])[:2]) for e in (flight.error, peer))
    print(f"Kingston: tight {ours:.2f} m, RTKLIB {theirs:.2f} m horizontal RMS")
    assert ours < theirs < 3.0
    assert np.isfinite(flight.error[both]).all()


@pytest.mark.parametrize("keep", [0, 2])
def test_half_a_minute_without_satellites_costs_metres(drive, keep):
    """With the clock's drift unknown two satellites tell little, and their reflections stay."""
    _, elevation = drive.geometry()
    flight = fly(drive, RAW_ALL, hidden=without(drive, (870.0, 900.0), keep, elevation))
    k = int(np.searchsorted(drive.observed.time, 899.5)) - 1
    end = float(np.hypot(*flight.error[k, :2]))
    print(f"Kingston: {end:.1f} m after 30 s with {keep} satellites")
    assert end < 10.0
    assert np.isfinite(flight.position[k:]).all()
