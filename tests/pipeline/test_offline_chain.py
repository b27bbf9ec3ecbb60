"""Source to position in one process on a simulated signal: the fix is where the truth is."""

from collections import defaultdict

import graph_runs
import numpy as np
import pytest
from graph_runs import ABSENT, RATE

from deepseis_bringup.graph import GraphConfig
from deepseis_bringup.offline import OfflineChain
from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.types import PvtStatus

LENGTH = 26.0


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return graph_runs.recording(tmp_path_factory.mktemp("recording"), LENGTH)


def chain(recording, **source):
    config = GraphConfig(
        source={"file": str(recording.if_path), **source},
        sample_rate_hz=RATE,
        satellites=(ABSENT, *recording.satellites),
        parameters={"tracker": {"reference_week": 2399}},
    )
    return OfflineChain(config)


@pytest.fixture(scope="module")
def outputs(recording):
    """Values by topic."""
    found = defaultdict(list)
    for output in chain(recording).run():
        found[output.topic].append(output.value)
    return found


def test_all_satellites_of_the_signal_and_no_other_are_acquired(outputs, recording):
    results = {r.satellite: r.detected for r in outputs["acquisition/result"]}
    assert {name for name, detected in results.items() if detected} == set(recording.satellites)
    assert ABSENT in results


def test_ephemerides_are_those_of_the_signal(outputs, recording):
    truth = {e.satellite: e for e in read_rinex_nav(recording.nav_path).ephemerides}
    decoded = outputs["gnss/ephemeris"]
    assert sorted(e.satellite for e in decoded) == sorted(recording.satellites)
    for item in decoded:
        for name in ("week", "toe", "toc", "af0", "sqrt_a", "eccentricity", "m0", "omega0", "i0"):
            assert getattr(item, name) == pytest.approx(getattr(truth[item.satellite], name))


def test_the_first_fix_comes_when_the_third_subframe_is_complete(outputs):
    # 2 s + 3 subframes of 6 s + the delay D of 0.1 s, then the next attempt (0.1 s).
    first = outputs["gnss/pvt"][0].sample_index / RATE
    assert 20.0 < first < 20.5


def test_positions_are_near_the_truth_as_their_covariance_says(outputs, recording):
    truth = np.load(recording.truth_path)["antenna_ecef"][0]
    solutions = [p for p in outputs["gnss/pvt"] if p.status == PvtStatus.SINGLE]
    assert len(solutions) == len(outputs["gnss/pvt"]) > 50
    latitude, longitude, _ = geodetic_from_ecef(truth)
    turn = rotation_enu_ecef(latitude, longitude)
    errors = np.array([turn @ (p.position_ecef - truth) for p in solutions])
    sigmas = np.array(
        [
            np.sqrt(np.diag(turn @ np.reshape(p.position_covariance_ecef, (3, 3)) @ turn.T))
            for p in solutions
        ]
    )
    # Before page 18 the ionosphere is unknown: metres of bias, which the covariance includes.
    assert (np.abs(errors).mean(axis=0) < 3 * sigmas.mean(axis=0)).all()
    assert sigmas.mean() < 15.0
    # Thermal noise of a 1 Hz DLL with 0.5 chips at 42 dB-Hz (Kaplan and Hegarty, eq. 5.22):
    # sqrt(B d / (2 C/N0)) = 4e-3 chips = 1.16 m, times the geometry. 5.8 s hold some 20
    # independent values, whose scatter is known to a sixth.
    up = errors[:, 2].std()
    assert up < 1.16 * solutions[0].vdop * 1.5
    assert np.hypot(*errors[:, :2].std(axis=0)) < 1.16 * solutions[0].hdop * 1.5


def test_velocity_of_a_still_antenna_is_zero(outputs):
    # Phase noise of 1 mm over 20 ms is 0.05 m/s; times the geometry.
    velocities = np.array([p.velocity_ecef for p in outputs["gnss/pvt"]])
    assert np.abs(velocities.mean(axis=0)).max() < 0.05
    assert velocities.std(axis=0).max() < 0.3


def test_observations_end_with_the_samples(recording):
    """A promise of an idle channel reaches further than the recording: nothing is made of it."""
    values = [
        output.value
        for output in chain(recording, length_s=21.26).run()
        if output.topic == "gnss/observations"
    ]
    assert values[-1].sample_index < 21.26 * RATE
    assert all(len(item.satellites) == len(recording.satellites) for item in values[:-1])
    assert len(values[-1].satellites) > 0
