"""A signal nobody here made, 1.9 g, through the whole chain: the INS aids, not the truth.

The IMU is synthesised on the truth's motion with a grade's errors and a lever arm of a metre; the
chain gets samples, IMU, survey, orbits and coarse time.
"""

import numpy as np
import pytest

from deepseis_bringup.accept.independent import IndependentScene, displacement
from deepseis_bringup.accept.loop_measures import pooled
from deepseis_bringup.accept.outside_recording import CarriedImu
from deepseis_bringup.accept.scene import aided


@pytest.fixture(scope="module")
def run(shared_data, tmp_path_factory):
    place = tmp_path_factory.mktemp("independent") / "bag"
    scene = IndependentScene(shared_data, place, CarriedImu())
    return scene, scene.run(aided(8.0))


def test_all_seven_are_held_without_a_slip(run):
    scene, outcome = run
    assert len(scene.truth.satellites) == 7
    assert outcome.held() == 7


def test_the_phase_is_true_while_it_moves_as_at_rest(run):
    _, outcome = run
    for part in (outcome.still, outcome.moving):
        # The goal for the median satellite, 42.6 dB-Hz behind the quantiser: 1.22 deg by noise.
        assert np.median([item.error_rms for item in part]) <= 1.3
    # Seven strong satellites are noise to each other, 0.35 dB: 1.04; the constant is told from
    # 3.8 s: 1.01.
    assert pooled(outcome.ratios()) <= 1.10


def test_the_circle_is_in_the_phases(run):
    error, gain = displacement(*run)
    assert np.hypot(*error[:2]) <= 1e-3
    assert gain == pytest.approx(1.0, abs=0.002)


def test_all_seven_are_held_12_db_below_the_signal_that_was_made(shared_data, tmp_path):
    """10 dB by noise added to the samples, 2 dB by their 1 bit: 27 to 34 dB-Hz."""
    scene = IndependentScene(shared_data, tmp_path / "bag", CarriedImu(), weaker_db=10.0)
    outcome = scene.run(aided(3.0))
    assert outcome.held() == 7
    assert np.median([item.error_rms for item in outcome.moving]) <= 4.0
    assert pooled(outcome.ratios()) <= 1.10
