"""Fusion and trackers killed during the quake: the station goes on, says so, has them back."""

from dataclasses import dataclass

import graph_runs
import numpy as np
import pytest
from realtime_quake import BUSY, by_the_clock, make_scene, payloads_of
from scipy.interpolate import CubicSpline

from deepseis_bringup.accept.scene import RATE_HZ, aided
from deepseis_bringup.graph import build_graph
from deepseis_bringup.restarts import Restarts
from deepseis_bringup.supervisor import Supervisor, own_domain, running
from deepseis_bringup.watch import GraphWatch
from deepseis_core.ros import codecs
from deepseis_core.types import Lli, PvtStatus, TrackingFlag, TrackingMode

pytestmark = [pytest.mark.launch, pytest.mark.timeout(300)]

KILL, LENGTH = 7.5, 26.0
PACE = 0.25 if BUSY else 0.5
AFTER = 2.5
"""From the return of one to the death of the next, and to the end [s]."""


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return make_scene(tmp_path_factory.mktemp("scene"), LENGTH)


@dataclass(frozen=True)
class Outage:
    """Of one process [s of samples]: its death, and when it spoke for samples again."""

    died: float
    back: float


@pytest.fixture(scope="module")
def faults(scene, tmp_path_factory):
    """When the victims were away, and what was recorded."""
    folder = tmp_path_factory.mktemp("run")
    config = scene.config(aided(8.0))
    config = by_the_clock(config, folder, PACE)
    restarts, died, back = Restarts(), {}, {}
    with own_domain() as environment:
        nodes = Supervisor(build_graph(config), folder, environment=environment, restarts=restarts)
        with running(nodes), GraphWatch(environment, restarts=restarts) as watch:

            def poll():
                now = watch.poll() / RATE_HZ
                due = {"fusion": KILL, "trackers": back.get("fusion", LENGTH) + AFTER}
                for name, at in due.items():
                    if now > at and name not in died:
                        died[name] = now
                        nodes.processes[name].kill()
                    is_back = name in died and restarts.fates and name not in restarts.missing
                    if is_back and restarts.fates.get(name) and name not in back:
                        back[name] = now
                if now > back.get("trackers", LENGTH) + AFTER:
                    nodes.end(["if_source"])

            nodes.wait(poll=poll, timeout=200)
    assert set(nodes.statuses().values()) == {0}
    assert set(back) == {"fusion", "trackers"}, "the recording was too short for this machine"
    run = graph_runs.Run(folder, {})
    payloads = payloads_of(run)
    return {name: Outage(died[name], back[name]) for name in back}, run, payloads


def tracks(payloads):
    """Batches, starts [s] and flags of every satellite."""
    for topic, messages in payloads.items():
        if topic.startswith("tracking/"):
            batches = [codecs.TRACKING_EPOCHS.decode(data)[0] for data in messages]
            start = np.concatenate([b.sample_index for b in batches]) / RATE_HZ
            yield batches, start, np.concatenate([b.flags for b in batches])


def test_it_is_said_who_died_and_that_all_are_back(faults):
    _, run, _ = faults
    said = run.statuses()["supervisor"]
    texts = " ".join(text for level, text, _ in said if level == 2)
    for name in ("fusion", "trackers"):
        assert f"{name} started again: it was killed by signal 9" in texts
    level, text, values = said[-1]
    assert (level, text, values["restarts"]) == (1, "all nodes run", "2")


def test_latencies_are_measured_each_second(faults):
    _, run, _ = faults
    measured = {"fusion": ["imu_to_aiding"], "trackers": ["imu_to_use", "aiding_to_use"]}
    for name, keys in measured.items():
        said = [values for _, _, values in run.statuses()[f"{name} latency"]]
        for key in keys:
            found = [item for item in said if f"{key}_count" in item]
            assert len(found) >= 4, (name, key)
            for item in found:
                count, median, p99, longest = (
                    float(item[f"{key}_{what}"])
                    for what in ("count", "median_ms", "p99_ms", "max_ms")
                )
                assert 1 <= count <= 100
                assert 0.0 < median <= p99 <= longest < 30_000.0


def test_the_aiding_is_back_within_two_seconds_of_the_process(faults):
    outages, _, payloads = faults
    spans = [codecs.DOPPLER_AIDING.decode(data)[0] for data in payloads["aiding/doppler"]]
    begins = np.array([span.valid_from for span in spans]) / RATE_HZ
    valid = np.array([span.valid for span in spans])
    (hole,) = np.flatnonzero(np.diff(begins) > 0.021)
    assert abs(begins[hole] - outages["fusion"].died) < 0.5
    regained = begins[hole + 1 :][valid[hole + 1 :]][0]
    assert regained - begins[hole + 1] < 2.0
    # Without trackers there are no positions: the fusion goes on with the IMU alone.
    away = (begins > outages["trackers"].died) & (begins < outages["trackers"].back)
    assert valid[away].mean() > 0.5


def test_the_loops_go_on_without_aiding_and_with_it_again(faults):
    outages, _, payloads = faults
    without, died = outages["fusion"], outages["trackers"].died
    for batches, start, flags in tracks(payloads):
        one_life = (start > 2.0) & (start < died - 0.2)
        assert (flags[one_life] & TrackingFlag.PHASE_LOCK).all()
        assert not (flags[one_life] & TrackingFlag.SLIP).any()
        assert (flags & TrackingFlag.AID_MISSED).any()
        place = [b.block_sample_index / RATE_HZ for b in batches]
        modes = [b.mode for b, t in zip(batches, place, strict=True) if t < died - 0.2]
        unaided = [m for m, t in zip(modes, place, strict=False) if without.died + 0.3 < t]
        assert TrackingMode.TRACK in unaided
        assert modes[-1] == TrackingMode.TRACK_AIDED


def test_the_trackers_have_their_satellites_back_within_two_seconds_of_the_process(faults):
    outages, _, payloads = faults
    back = outages["trackers"].back
    for batches, start, flags in tracks(payloads):
        again = start[(start > back - 0.1) & (flags & TrackingFlag.PHASE_LOCK != 0)]
        assert again[0] < back + 2.0
        # Not of the last one: an IMU that is late on a busy machine takes the aiding away again.
        assert TrackingMode.TRACK_AIDED in {
            batch.mode for batch in batches if batch.block_sample_index > back * RATE_HZ
        }


def test_positions_stop_with_the_trackers_only(faults):
    outages, _, payloads = faults
    gone = outages["trackers"]
    positions = [codecs.PVT.decode(data)[0] for data in payloads["gnss/pvt"]]
    positions = [p for p in positions if p.sample_index > 2.0 * RATE_HZ]
    assert set(np.diff([p.tow_ns for p in positions]).tolist()) == {100_000_000}
    by_time = {p.sample_index / RATE_HZ: p for p in positions}
    before = [p for t, p in by_time.items() if t < gone.died - 0.5]
    assert {p.status for p in before} == {PvtStatus.SINGLE}
    assert min(len(p.satellites) for p in before) == 9
    after = [t for t, p in by_time.items() if t > gone.back and p.status == PvtStatus.SINGLE]
    assert after[0] < gone.back + 2.0


def test_every_satellite_is_observed_again_with_a_mark(faults):
    outages, _, payloads = faults
    gone = outages["trackers"]
    epochs = [codecs.OBSERVATIONS.decode(data)[0] for data in payloads["gnss/observations"]]
    # Not from when its first word was noticed: its first samples may have come before that.
    seen = np.array([e.sample_index for e in epochs if e.satellites]) / RATE_HZ
    seen = seen[seen > gone.died - 2.0]
    hole = np.argmax(np.diff(seen))
    assert abs(seen[hole] - gone.died) < 1.0
    assert seen[hole + 1] < gone.back + 2.0
    first = {}
    for epoch in epochs:
        if epoch.sample_index > (seen[hole] + 0.01) * RATE_HZ:
            for name, lli in zip(epoch.satellites, epoch.lli, strict=True):
                first.setdefault(name, lli)
    assert len(first) == 9
    assert all(lli & Lli.SLIP for lli in first.values())
    assert not any(lli & Lli.SLIP for lli in epochs[-1].lli)


def test_no_phase_is_published_that_slipped_without_a_mark(faults, scene):
    _, _, payloads = faults
    splines = {
        name: CubicSpline(scene.truth.t, scene.truth.phase_cycles[:, k])
        for k, name in enumerate(scene.truth.satellites)
    }
    last, steps = {}, []
    for data in payloads["gnss/observations"]:
        epoch = codecs.OBSERVATIONS.decode(data)[0]
        t = (epoch.sample_index + epoch.sample_fraction) / RATE_HZ
        for name, phase, lli in zip(
            epoch.satellites, epoch.carrier_phase_cycles, epoch.lli, strict=True
        ):
            constant = phase + float(splines[name](t))
            marked = bool(lli & Lli.SLIP)
            if name in last and not marked:
                steps.append(constant - last[name])
            last[name] = constant
    assert len(steps) > 1000
    # 50 Hz alone at 43 dB-Hz: 0.01 cycles of noise; half a cycle is a slip.
    assert np.abs(steps).max() < 0.15
