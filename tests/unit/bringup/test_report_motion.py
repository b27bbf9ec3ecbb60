"""Ground motion of a recorded run: streams, events and errors come out as they were published."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepseis_bringup.bags.mcap_recording import BagWriter
from deepseis_bringup.report import run_report as report
from deepseis_bringup.report.run_data import RunData
from deepseis_bringup.report.run_motion import (
    FUSED,
    GNSS,
    RTK,
    Moved,
    errors,
    events,
    streams,
    truth_at,
)
from deepseis_bringup.report.run_truth import Truth
from deepseis_core.geodesy import ecef_from_enu, ecef_from_geodetic
from deepseis_core.gps_time import GpsTime
from deepseis_core.ros import codecs
from deepseis_core.types import (
    Displacement,
    FloatArray,
    Observations,
    PrecisePosition,
    PreciseStatus,
    SeismicEvent,
    Stamp,
    TrackingEpochs,
)

START = GpsTime(2300, 345_600 * 10**9)
START_NS = START.to_utc_ns()
RATE, BLOCK, SECONDS = 1_000_000, 20_000, 6.0
CLOCK_S = 3e-4
"""Receiver time is ahead of the samples' count by this."""
FAST = 4
"""Epochs of the fused motion in a block."""
PLACE = ecef_from_geodetic(np.array([0.6, 2.4, 50.0]))
OFF = {"fused": 1e-3, "gnss": 3e-3, "rtk": -2e-3}
ONSET = 3.0


def motion(t: FloatArray) -> FloatArray:
    """Return displacements, east, north, up [m]."""
    s = np.clip(t - ONSET, 0.0, None)
    return np.stack([0.1 * np.sin(5.0 * s) * (s > 0), 0.3 * np.tanh(s), 0.0 * s], axis=1)


def empty(kind: type[Any], **given: Any) -> Any:
    """Return a value whose other fields hold a number each."""
    known = {item.name: np.zeros(1) for item in fields(kind)}
    return kind(**{**known, **given})


def ground(source: int, t: FloatArray, off: float) -> Displacement:
    """Return a span of motion; its times are receiver times."""
    tow = START.tow_ns + np.round((t + CLOCK_S) * 1e9).astype(np.int64)
    small, unknown = np.full((len(t), 3), 1e-3, np.float32), np.full((len(t), 3), np.nan)
    rates = np.gradient(motion(np.linspace(0, 6, 601)), 0.01, axis=0)[:: 600 // len(t)][: len(t)]
    fast = rates if source == 2 else unknown
    return Displacement(
        source, False, 0, 0.005, tow, START.week, motion(t) + off, fast, fast, small, small, small
    )


def position(sample: int, moved: FloatArray, status: int) -> PrecisePosition:
    """Return one against a base."""
    return PrecisePosition(
        sample, START.week, 0, sample, "rtk", status, moved, np.eye(3).ravel() * 1e-6, 0.0, 0.0
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 6 s that begins to move after 3."""
    folder: Path = tmp_path_factory.mktemp("run")
    with BagWriter(folder / "bag") as bag:

        def put(topic: str, kind: str, data: bytes, utc_ns: int) -> None:
            bag.write(topic, f"deepseis_msgs/msg/{kind}", data, utc_ns, utc_ns)

        for k in range(round(SECONDS * RATE / BLOCK)):
            sample, t = k * BLOCK, k * BLOCK / RATE
            utc_ns = START_NS + round(t * 1e9)
            late_ns = utc_ns + round(CLOCK_S * 1e9)
            tracked = empty(
                TrackingEpochs, satellite="G01", block_sample_index=sample, mode=3,
                valid_through=sample + BLOCK - 1, ephemeris_count=0,
                sample_index=np.array([sample]), sample_count=np.array([BLOCK], np.int32),
            )  # fmt: skip
            data = codecs.TRACKING_EPOCHS.encode(tracked, utc_ns)
            put("tracking/G01/epochs", "TrackingEpochs", data, utc_ns)
            seen = empty(
                Observations, sample_index=sample, sample_fraction=0.0, week=START.week,
                tow_ns=0, valid_through=0, interval=0.02, satellites=("G01",),
            )  # fmt: skip
            put("gnss/observations", "Observations", codecs.OBSERVATIONS.encode(seen, late_ns),
                late_ns)  # fmt: skip
            times = t + 0.005 * np.arange(FAST)
            for source, off in ((2, OFF["fused"]), (0, OFF["gnss"])):
                value = ground(source, times if source else times[:1], off)
                put("seismo/displacement", "Displacement",
                    codecs.DISPLACEMENT.encode(value, late_ns, "map"), late_ns)  # fmt: skip
            status = PreciseStatus.FIX if k % 10 else PreciseStatus.FLOAT
            value = position(sample, motion(np.array([t]))[0] + OFF["rtk"], int(status))
            put("gnss/rtk", "PrecisePosition", codecs.PRECISE_POSITION.encode(value, utc_ns),
                utc_ns)  # fmt: skip
            if t >= ONSET and k % 10 == 0:
                put("seismo/event", "SeismicEvent",
                    codecs.SEISMIC_EVENT.encode(peaks(t), utc_ns), utc_ns)  # fmt: skip
    t = np.arange(0.0, SECONDS, 1e-3)
    np.savez(folder / "truth.npz", t_s=t, motion_t_s=t,
             antenna_ecef_m=ecef_from_enu(motion(t), PLACE))  # fmt: skip
    return folder


def peaks(t: float) -> SeismicEvent:
    """Return a report that grows."""
    sec, nanosec = divmod(START_NS + round(ONSET * 1e9), 10**9)
    return SeismicEvent(
        "DSEI-1", Stamp(sec, nanosec), t > 5.5, 30.0, 0.1 * (t - 2.9), 0.2, 0.4, 5e4, 6.5, 0.3
    )


def test_streams_have_their_times_and_values(run: Path) -> None:
    found = streams(RunData.read(run))
    assert list(found) == [FUSED, GNSS, RTK]
    for name, off, step in ((FUSED, "fused", 0.005), (GNSS, "gnss", 0.02)):
        stream = found[name]
        assert np.diff(stream.t) == pytest.approx(step, abs=1e-6)
        # Receiver time is turned into that of the samples.
        assert stream.t[0] == pytest.approx(0.0, abs=1e-6)
        assert stream.displacement == pytest.approx(motion(stream.t) + OFF[off], abs=1e-5)
    assert np.isfinite(found[FUSED].velocity).all()
    assert np.isnan(found[GNSS].velocity).all()
    # A tenth of the positions against a base are no fixes.
    assert len(found[RTK].t) == 270
    assert found[RTK].sd == pytest.approx(1e-3)


def test_an_event_is_what_its_reports_say(run: Path) -> None:
    (event,) = events(RunData.read(run))
    assert event.onset == pytest.approx(ONSET, abs=1e-6)
    assert event.t == pytest.approx(np.arange(3.0, 6.0, 0.2), abs=1e-6)
    assert event.peaks[:, 0] == pytest.approx(0.1 * (event.t - 2.9), abs=1e-6)
    assert event.ended
    assert event.magnitude == pytest.approx(6.5)


def test_summary_and_page_tell_the_motion(run: Path) -> None:
    summary = report.write_report(run, truth=run / "truth.npz")
    assert summary["events"] == 1
    assert summary["onset_s"] == pytest.approx(ONSET, abs=1e-6)
    assert summary["pgd_m"] == pytest.approx(0.29, abs=1e-6)
    key = "displacement_error_horizontal_m.fused_real_time"
    assert summary[key] == pytest.approx(np.sqrt(2.0) * OFF["fused"], rel=0.02)
    page = (run / "report.html").read_text(encoding="utf-8")
    told = "The ground moved from 3.0 s on: peak acceleration 0.0408 g, displacement 0.29 m, known"
    words = ("Ground motion", FUSED, GNSS, RTK, "PGD 0.29 m", "magnitude 6.5", "Peaks as", told)
    for text in words:
        assert text in page or json.dumps(text)[1:-1] in page, text


def test_fused_motion_is_compared_with_the_imu_and_gnss_with_the_antenna(tmp_path: Path) -> None:
    """A mast of 1 m that leans east by an angle: its top moves, its foot stands."""
    t = np.arange(0.0, SECONDS, 1e-2)
    lean = 0.05 * np.sin(t)
    moved = np.stack([np.sin(lean), 0.0 * t, np.cos(lean)], axis=1)
    turns = np.stack([0.0 * t, np.sin(lean / 2), 0.0 * t, np.cos(lean / 2)], axis=1)
    values = {"t_s": t, "motion_t_s": t, "antenna_ecef_m": ecef_from_enu(moved, PLACE)}
    lever = np.array([0.0, 0.0, 1.0])
    np.savez(tmp_path / "truth.npz", **values, orientation_xyzw=turns, imu_to_antenna=lever)
    truth = Truth.read(tmp_path / "truth.npz")
    assert truth_at(truth, t) == pytest.approx(moved - moved[0], abs=1e-7)
    assert truth_at(truth, t, of_imu=True) == pytest.approx(0.0, abs=1e-6)
    still = Moved(t, *(np.zeros((len(t), 3)),) * 4)
    off = errors({FUSED: still, GNSS: still}, truth)
    assert np.abs(off[FUSED]).max() < 1e-6
    assert np.abs(off[GNSS]).max() == pytest.approx(0.05, rel=1e-3)
    # A truth that does not know where the IMU sits is the antenna's for both.
    np.savez(tmp_path / "old.npz", **values)
    off = errors({FUSED: still, GNSS: still}, Truth.read(tmp_path / "old.npz"))
    assert off[FUSED] == pytest.approx(off[GNSS])
