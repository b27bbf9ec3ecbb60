"""Onsets against ObsPy's, peaks against the motion's own, magnitudes against the relation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from deepseis_bringup.export.quiet_obspy import obspy_modules
from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_geodetic, geodetic_from_ecef
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import Displacement, FloatArray, SeismicEvent
from deepseis_ins import pgd_magnitude as pgd
from deepseis_ins.event_engine import EventConfig, EventEngine, Report
from deepseis_ins.onset import OnsetConfig, OnsetDetector
from deepseis_sim.accelerogram import read_accelerogram

RATE = 200.0
TIME = GpsTime(2000, 0)
STATION = np.array([-3957200.0, 3310200.0, 3737700.0])


def noisy_onset(seed: int, onset: float, seconds: float) -> FloatArray:
    """Return accelerations: noise, then shaking from an onset on, (n, 3) [m/s^2]."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / RATE)
    shaking = np.where(t > onset, np.sin(2 * np.pi * 3.0 * (t - onset)), 0.0)
    return random.normal(0.0, 0.01, (len(t), 3)) + shaking[:, None] * [1.0, 0.5, 0.2]


def test_ratio_is_obspys_recursive_one() -> None:
    obspy_modules()
    from obspy.signal.trigger import recursive_sta_lta, trigger_onset

    acceleration = noisy_onset(1, 14.0, 16.0)
    config = OnsetConfig(onset_ratio=25.0)
    detector = OnsetDetector(config, RATE)
    ratios, begins = [], []
    for row in range(0, len(acceleration), 4):
        ratio, triggers = detector.push(acceleration[row : row + 4])
        ratios.append(ratio)
        begins += [row + item.row for item in triggers if item.began]
    norm = np.sqrt((acceleration**2).sum(axis=1))
    oracle = recursive_sta_lta(norm, round(0.2 * RATE), round(10.0 * RATE))
    found = np.concatenate(ratios)
    (begin,) = begins
    # ObsPy begins with the second sample; after 10 s that has faded, and before its ratio is 0.
    before = slice(round(10.0 * RATE) + 5, begin)
    assert found[before] == pytest.approx(oracle[before], rel=0.01)
    assert begin == trigger_onset(oracle, 25.0, 4.0)[0][0]
    assert 0.0 < begin / RATE - 14.0 < 0.05


def test_noise_alone_triggers_nothing() -> None:
    random = np.random.default_rng(2)
    detector = OnsetDetector(OnsetConfig(), RATE)
    _, triggers = detector.push(random.normal(0.0, 0.05, (round(600 * RATE), 3)))
    assert triggers == []


def test_relation_and_its_inverse() -> None:
    # Crowell et al. 2016: log10 PGD[cm] = -6.687 + 1.500 M - 0.214 M log10 R[km].
    assert pgd.magnitude(0.10, 50e3) == pytest.approx((1.0 + 6.687) / (1.5 - 0.214 * 1.69897))
    for size in (5.0, 7.0, 9.0):
        assert pgd.magnitude(pgd.peak_displacement(size, 80e3), 80e3) == pytest.approx(size)
    assert np.isnan(pgd.magnitude(0.0, 80e3))
    assert pgd.magnitude_sd(1.0, 1e-3, 80e3) == pytest.approx(pgd.SCATTER, rel=1e-3)
    assert pgd.magnitude_sd(0.01, 0.01, 80e3) > 1.2 * pgd.SCATTER


def test_distance_to_a_hypocentre_below_the_station() -> None:
    assert np.isnan(pgd.hypocentral_distance(STATION, []))
    latitude, longitude, height = geodetic_from_ecef(STATION)
    below = [float(np.degrees(latitude)), float(np.degrees(longitude)), 24.0]
    assert pgd.hypocentral_distance(STATION, below) == pytest.approx(24e3 + height, rel=1e-9)
    with pytest.raises(InputError, match="hypocentre"):
        pgd.hypocentral_distance(STATION, [100.0, 0.0, 0.0])


def moving(t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return 8 s of growing and fading 0.5 Hz, 30 cm, with a step of 1 m; from 20 s on."""
    s = np.clip((t - 20.0) / 8.0, 0.0, 1.0)
    step = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    x = 0.3 * np.sin(np.pi * s) ** 3 * np.sin(np.pi * (t - 20.0)) + step
    d = np.stack([x, 0.5 * x, 0.0 * x], axis=1)
    v = np.gradient(d, 1.0 / RATE, axis=0)
    return d, v, np.gradient(v, 1.0 / RATE, axis=0)


def reports(
    engine: EventEngine,
    settled: float = 0.0,
    *,
    seconds: float = 45.0,
    each: Callable[[int], None] = lambda _row: None,
    into: list[Report] | None = None,
) -> tuple[list[Report], FloatArray]:
    """Feed spans of 20 ms; ``settled`` is where the ground has been before [m]."""
    t = np.arange(0.0, seconds, 1.0 / RATE)
    d, v, a = moving(t)
    a = a + np.random.default_rng(5).normal(0.0, 3e-3, a.shape)
    found = [] if into is None else into
    for row in range(0, len(t), 4):
        each(row)
        part, n = slice(row, row + 4), 4
        sd = np.full((n, 3), 1e-3, np.float32)
        motion = Displacement(
            2, False, row, 1.0 / RATE, np.round(t[part] * 1e9).astype(np.int64), TIME.week,
            d[part] + settled, v[part], a[part], sd, sd, sd,
        )  # fmt: skip
        now = TIME.to_utc_ns() + round(t[row + 3] * 1e9)
        for report in engine.push(motion):
            assert 0 <= now - report.utc_ns <= 20_000_000
            found.append(report)
    return found, np.hstack([d, v, a])


@pytest.mark.parametrize("settled", [0.0, 0.7])
def test_an_event_from_onset_to_end(settled: float) -> None:
    below = [35.0, 140.0, 30.0]
    engine = EventEngine(EventConfig(hypocentre=below), OnsetConfig(), "DSEI", STATION)
    found, truth = reports(engine, settled)
    events: list[SeismicEvent] = [item.event for item in found]
    assert [item.ended for item in events] == [False] * (len(events) - 1) + [True]
    assert len({item.event_id for item in events}) == 1
    assert events[0].event_id.startswith("DSEI-")
    onset = events[0].onset.sec + 1e-9 * events[0].onset.nanosec - TIME.to_utc_ns() * 1e-9
    assert 20.0 < onset < 20.6
    gaps = np.diff([item.utc_ns for item in found]) * 1e-9
    assert gaps.max() <= 0.5
    for name, columns in (("displacement", slice(0, 3)), ("velocity", slice(3, 6)),
                          ("acceleration", slice(6, 9))):  # fmt: skip
        peaks = [getattr(item, f"peak_{name}") for item in events]
        assert np.all(np.diff(peaks) >= 0.0)
        assert peaks[-1] == pytest.approx(
            np.linalg.norm(truth[:, columns], axis=1).max(), rel=0.01
        )
    last = events[-1]
    assert last.magnitude == pytest.approx(
        pgd.magnitude(last.peak_displacement, last.hypocentral_distance)
    )
    assert last.hypocentral_distance == pytest.approx(engine.distance)
    assert np.isnan(events[0].magnitude)  # nothing has moved yet


BELOW = [35.0, 140.0, 30.0]


def located(at: dict[float, list[float]], **settings: float) -> tuple[EventEngine, list[Report]]:
    """Return an engine after 60 s and its reports; hypocentres are given at times [s]."""
    engine, due, found = EventEngine(EventConfig(**settings), OnsetConfig(), "", STATION), at, []

    def told(row: int) -> None:
        for time in [t for t in due if row / RATE >= t]:
            found.extend(engine.locate(due.pop(time)))

    reports(engine, each=told, seconds=60.0, into=found)
    return engine, found


def test_a_hypocentre_that_is_known_in_the_middle_of_an_event() -> None:
    _, found = located({25.0: BELOW})
    before = [item.event for item in found if item.utc_ns < TIME.to_utc_ns() + 24_900_000_000]
    assert len(before) > 15
    assert np.isnan([[item.hypocentral_distance, item.magnitude] for item in before]).all()
    at_once = next(item for item in found if item.event.magnitude > 0.0)
    assert at_once.utc_ns - TIME.to_utc_ns() == pytest.approx(25.0e9, abs=20e6)
    whole = reports(EventEngine(EventConfig(hypocentre=BELOW), OnsetConfig(), "", STATION))[0]
    assert found[-1].event == whole[-1].event  # as if it had been known


def test_a_hypocentre_that_is_known_after_the_event() -> None:
    engine, found = located({50.0: BELOW})
    known, last = found[-2:]
    assert known.event.ended
    assert np.isnan(known.event.magnitude)
    assert last.event.ended
    assert (last.utc_ns, last.event.event_id) == (known.utc_ns, known.event.event_id)
    assert last.event.magnitude == pytest.approx(
        pgd.magnitude(last.event.peak_displacement, engine.distance)
    )
    (taken_back,) = engine.locate([])
    assert np.isnan([taken_back.event.hypocentral_distance, taken_back.event.magnitude]).all()


def test_a_hypocentre_is_not_that_of_other_earthquakes() -> None:
    _, of_before = located({5.0: BELOW}, hypocentre_valid_s=10.0)
    _, of_after = located({50.0: BELOW}, hypocentre_valid_s=10.0)
    _, soon = located({15.0: BELOW}, hypocentre_valid_s=10.0)
    assert np.isnan([item.event.magnitude for item in [*of_before, *of_after]]).all()
    assert soon[-1].event.magnitude > 0.0


def test_a_hypocentre_that_is_none_changes_nothing() -> None:
    engine = EventEngine(EventConfig(hypocentre=BELOW), OnsetConfig(), "", STATION)
    before = engine.distance
    for wrong in ([35.0, 140.0], [95.0, 140.0, 10.0], [float("inf"), 0.0, 0.0]):
        with pytest.raises(InputError, match="hypocentre"):
            engine.locate(wrong)
    assert engine.distance == before


def test_bad_settings_are_refused() -> None:
    with pytest.raises(InputError, match="report_s"):
        EventEngine(EventConfig(report_s=3.0), OnsetConfig(), "", STATION)
    with pytest.raises(InputError, match="long_s"):
        OnsetDetector(OnsetConfig(short_s=10.0, long_s=5.0), RATE)


def test_tohoku_by_a_geonet_station_is_a_magnitude_9(shared_data: Path) -> None:
    """GEONET 0915, 2011-03-11: 1 Hz of GNSS, hypocentre as published with it; USGS: Mw 9.1."""
    place = "displacement/tohoku2011_geonet_1hz/CI.0915.20.LY?.2011.070"
    d = read_accelerogram(shared_data / place, scale=1e-6).acceleration
    v = np.gradient(d, axis=0)
    a = np.gradient(v, axis=0)
    station = ecef_from_geodetic(np.array([*np.radians([38.686, 141.004]), 105.0]))
    # Samples of a second: averages of some of them, and a threshold above 1 Hz GNSS noise.
    onset = OnsetConfig(short_s=2.0, long_s=40.0, onset_ratio=5.0, end_ratio=1.5)
    engine = EventEngine(EventConfig(hypocentre=[38.297, 142.373, 29.0]), onset, "0915", station)
    found = []
    for row in range(len(d)):
        sd = np.full((1, 3), 5e-3, np.float32)
        time = np.array([round(row * 1e9)], np.int64)
        parts = (item[row : row + 1] for item in (d, v, a))
        found += engine.push(Displacement(2, False, row, 1.0, time, TIME.week, *parts, sd, sd, sd))
    assert found
    event = max((item.event for item in found), key=lambda item: item.peak_displacement)
    assert 100e3 < event.hypocentral_distance < 160e3
    assert event.peak_displacement == pytest.approx(4.25, abs=0.15)
    assert event.magnitude == pytest.approx(9.1, abs=pgd.SCATTER)
