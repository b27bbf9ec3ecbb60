"""Every other node of a station killed once (kill -9): it goes on, says so, has the node back."""

import time
from dataclasses import dataclass

import graph_runs
import numpy as np
import pytest
from realtime_quake import BUSY, ONSET, by_the_clock, make_scene, payloads_of

from deepseis_bringup.accept.scene import RATE_HZ, aided
from deepseis_bringup.base import with_base
from deepseis_bringup.graph import build_graph
from deepseis_bringup.restarts import Restarts
from deepseis_bringup.supervisor import Supervisor, own_domain, running
from deepseis_bringup.watch import GraphWatch
from deepseis_core.ros import codecs
from deepseis_core.types import MotionKind, PreciseStatus, PvtStatus, TrackingFlag

pytestmark = [pytest.mark.launch, pytest.mark.slow, pytest.mark.timeout(600)]

VICTIMS = ("imu_source", "pvt", "motion_state", "acquisition", "base_source")
FIRST, LENGTH = 9.0, 60.0
PACE = 0.2 if BUSY else 0.8
AFTER = 3.0
"""From the return of one to the death of the next, and to the end [s]."""
BACK_WITHIN = 2.0
"""From the new process' first word to what it is there for [s]."""


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return make_scene(tmp_path_factory.mktemp("scene"), LENGTH, base=True)


@dataclass
class Outage:
    """Of one process: its death and its first word after [s of samples], and how long [s]."""

    died: float
    back: float = np.inf
    away_s: float = 0.0


@pytest.fixture(scope="module")
def faults(scene, tmp_path_factory):
    """Outages by victim, and what was recorded."""
    folder = tmp_path_factory.mktemp("run")
    config = with_base(scene.config(aided(8.0)))
    config = by_the_clock(config, folder, PACE)
    restarts, outages, killed_at = Restarts(), {}, 0.0
    with own_domain() as environment:
        nodes = Supervisor(build_graph(config), folder, environment=environment, restarts=restarts)
        with running(nodes), GraphWatch(environment, restarts=restarts) as watch:

            def poll():
                nonlocal killed_at
                now = watch.poll() / RATE_HZ
                last = list(outages.values())[-1] if outages else Outage(0.0, FIRST - AFTER)
                if not np.isfinite(last.back):
                    name = VICTIMS[len(outages) - 1]
                    if restarts.fates.get(name) and name not in restarts.missing:
                        last.back, last.away_s = now, time.monotonic() - killed_at
                elif now > last.back + AFTER and len(outages) < len(VICTIMS):
                    outages[VICTIMS[len(outages)]] = Outage(now)
                    killed_at = time.monotonic()
                    nodes.processes[VICTIMS[len(outages) - 1]].kill()
                elif now > last.back + AFTER:
                    nodes.end(["if_source"])

            nodes.wait(poll=poll, timeout=500)
    assert set(nodes.statuses().values()) == {0}
    assert np.isfinite([outages[name].back for name in VICTIMS]).all(), (
        "too short for this machine"
    )
    for name, outage in outages.items():
        print(f"{name}: {outage.away_s:.2f} s from the kill to the new process' first word")
    run = graph_runs.Run(folder, {})
    payloads = payloads_of(run)
    return outages, run, payloads


def decoded(payloads, topic, codec):
    """Values of a topic."""
    return [codec.decode(data)[0] for data in payloads[topic]]


def test_it_is_said_who_died_and_that_all_are_back(faults):
    _, run, _ = faults
    said = run.statuses()["supervisor"]
    texts = " ".join(text for level, text, _ in said if level == 2)
    for name in VICTIMS:
        assert f"{name} started again: it was killed by signal 9" in texts
    level, text, values = said[-1]
    assert (level, text, values["restarts"]) == (1, "all nodes run", str(len(VICTIMS)))
    assert all(float(values[f"away_s_{name}"]) > 0.1 for name in VICTIMS)


def test_the_imu_comes_back_at_the_present_and_the_aiding_with_it(faults):
    outages, _, payloads = faults
    gone = outages["imu_source"]
    stamps = [
        graph_runs.decode("sensor_msgs/msg/Imu", d).header.stamp for d in payloads["imu/data_raw"]
    ]
    at = np.array([s.sec + 1e-9 * s.nanosec for s in stamps])
    at -= at[0] - 1.0 / 200.0
    assert (np.diff(at) > 0).all(), "nothing is played twice"
    (hole,) = np.flatnonzero(np.diff(at) > 0.0051)
    assert abs(at[hole] - gone.died) < 0.5
    # The new process' first word may be noticed here later than its first samples were sent.
    assert gone.died < at[hole + 1] < gone.back + 0.5, "not from the bag's beginning"
    spans = decoded(payloads, "aiding/doppler", codecs.DOPPLER_AIDING)
    begins = np.array([span.valid_from for span in spans]) / RATE_HZ
    valid = np.array([span.valid for span in spans])
    assert set(np.diff(begins).round(6)) == {0.02}, "it is spoken of every span"
    away = (begins > at[hole] + 0.1) & (begins < at[hole + 1])
    assert not valid[away].any(), "no aiding is made up of no IMU"
    assert valid[begins > at[hole + 1] + BACK_WITHIN].all(), "no other death takes it away"


def test_positions_are_back_after_pvt_s_death_and_miss_nothing_else(faults):
    outages, _, payloads = faults
    gone = outages["pvt"]
    found = [
        p for p in decoded(payloads, "gnss/pvt", codecs.PVT) if p.sample_index > 3.0 * RATE_HZ
    ]
    at = np.array([p.sample_index for p in found]) / RATE_HZ
    assert {p.status for p in found} == {PvtStatus.SINGLE}
    (hole,) = np.flatnonzero(np.diff(at) > 0.11)
    assert abs(at[hole] - gone.died) < 0.5
    assert at[hole + 1] < gone.back + BACK_WITHIN


def test_motion_is_told_again_after_its_detector_s_death(faults):
    outages, _, payloads = faults
    gone = outages["motion_state"]
    states = decoded(payloads, "motion/state", codecs.MOTION_STATE)
    at = np.array([s.valid_through for s in states]) / RATE_HZ
    kinds = np.array([s.state for s in states])
    assert (kinds[at > ONSET + 0.5] == MotionKind.MOVING).all()
    assert not ((at > gone.died + 0.1) & (at < gone.back - 0.5)).any()
    assert at[at > gone.back - 0.5][0] < gone.back + BACK_WITHIN


def test_the_base_is_back_with_a_fix(faults):
    outages, _, payloads = faults
    gone = outages["base_source"]
    base = decoded(payloads, "base/observations", codecs.OBSERVATIONS)
    at = np.array([o.sample_index for o in base]) / RATE_HZ
    assert (np.diff(at) > 0).all(), "nothing is played twice"
    step = np.median(np.diff(at))
    (hole,) = np.flatnonzero(np.diff(at) > 1.5 * step)
    assert gone.died < at[hole + 1] < gone.back + 0.5 + step, "not from the bag's beginning"
    rtk = decoded(payloads, "gnss/rtk", codecs.PRECISE_POSITION)
    later = [v for v in rtk if v.sample_index > (gone.back + BACK_WITHIN) * RATE_HZ]
    assert len(later) > 25
    assert {v.status for v in later} == {PreciseStatus.FIX}


def test_no_loop_loses_its_satellite_while_others_die(faults):
    outages, _, payloads = faults
    begin, end = outages["imu_source"].died - 2.0, outages["base_source"].back + AFTER - 0.5
    for topic, messages in payloads.items():
        if not topic.startswith("tracking/"):
            continue
        batches = [codecs.TRACKING_EPOCHS.decode(data)[0] for data in messages]
        start = np.concatenate([b.sample_index for b in batches]) / RATE_HZ
        flags = np.concatenate([b.flags for b in batches])
        chosen = (start > begin) & (start < end)
        assert (flags[chosen] & TrackingFlag.PHASE_LOCK).all(), topic
        assert not (flags[chosen] & TrackingFlag.SLIP).any(), topic


def test_the_acquisition_is_back_and_the_trackers_wait_for_it_no_more(faults):
    outages, run, payloads = faults
    gone = outages["acquisition"]
    missed = [
        int(pair.partition("-")[0]) / RATE_HZ
        for _, _, values in run.statuses().get("trackers misses", ())
        for pair in values.get("acquisition", "").split()
    ]
    assert [t for t in missed if gone.died < t < gone.back]
    assert not [t for t in missed if t > gone.back + BACK_WITHIN]
    searches = decoded(payloads, "acquisition/result", codecs.ACQUISITION_RESULT)
    assert [r for r in searches if r.sample_index > (gone.back - 0.5) * RATE_HZ]
