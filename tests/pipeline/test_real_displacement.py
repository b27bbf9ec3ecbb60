"""A real antenna that stands still: what the displacement says it does, and how sure it is."""

import numpy as np
import pytest
from real_rest import watch


@pytest.fixture(scope="module")
def watched(shared_data):
    return watch(shared_data)


def test_right_after_the_calibration_it_is_still_to_millimetres(watched):
    rms = np.sqrt(np.mean(watched.displacement[:, 1:3] ** 2, axis=(0, 1)))
    assert (rms < [0.003, 0.003, 0.010]).all()


def test_satellite_clocks_make_it_creep_by_centimetres(watched):
    """The goal of 3 and 8 mm over 100 s is one of loops; clocks of real satellites miss it."""
    rms = np.sqrt(np.mean(watched.displacement[:, 100] ** 2, axis=0))
    assert (rms > [0.008, 0.008, 0.02]).all()
    assert (rms < [0.040, 0.040, 0.120]).all()


@pytest.mark.parametrize("seconds", [10, 30, 100])
def test_and_it_says_so(watched, seconds):
    """17 overlapping runs, one sky: some five independent ones of three axes; 4 sigma of 15."""
    assert 0.2 < np.mean(watched.normalised[:, seconds]) / 3.0 < 2.5
