"""Acquisition of recordings by others: all satellites listed, and none that is not there.

``listed`` are those of the recordings' list. ``low`` are further satellites that the search finds;
that they were there is shown by outside orbits: their Doppler is the predicted one plus the same
oscillator offset as the listed ones'. SX-NSR comes with its broadcast ephemerides. For the others
those of 2022-01-01 serve: orbits repeat after a day less 245 s, and in the 30 to 40 days between
the satellites drifted by less than two degrees.
"""

import base64
import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

from deepseis_core.baseband import Baseband
from deepseis_core.ephemeris import pack, select_ephemerides
from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.gps_time import GpsTime
from deepseis_core.if_format import IfFormat
from deepseis_core.propagation import line_of_sight
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.types import IfBlock
from deepseis_tracking.acquisition import Acquirer, AcquisitionConfig
from deepseis_tracking.acquisition_codes import GPS
from deepseis_tracking.acquisition_windows import visible_windows

REPEAT_NS = 86_155_000_000_000  # two orbits, a sidereal day less the drift of the node
TOKYO = ecef_from_geodetic(np.array([np.radians(35.7), np.radians(139.8), 50.0]))
OXFORD = ecef_from_geodetic(np.array([np.radians(51.7602), np.radians(-1.2574), 100.0]))


def names(text):
    return {f"G{int(prn):02d}" for prn in text.split()}


@dataclass(frozen=True)
class Capture:
    path: str
    format: str
    rate_hz: float
    if_hz: float
    start: GpsTime
    position: np.ndarray
    listed: str
    low: str = ""
    sums: int = 25
    navigation: str = "independent_sim/brdc0010.22n"
    repeats: int = 0
    doppler_error_hz: float = 150.0  # orbits drift by up to a degree in 40 days


def utc(*calendar):
    return GpsTime.from_utc_calendar(*calendar)


CAPTURES = {
    "pocketsdr_4MHz": Capture(
        "pocketsdr/L1_20211202_084700_4MHz_IQ.bin",
        *("iq8 inverted", 4e6, 0.0, utc(2021, 12, 2, 8, 47, 0), TOKYO),
        "26 31 16 29 32 18",
        "25 4 3 27",
        repeats=30,
    ),
    "pocketsdr_12MHz": Capture(
        "pocketsdr/L1_20211125_004000_12MHz_I.bin",
        *("real8", 12e6, 3e6, utc(2021, 11, 25, 0, 40, 0), TOKYO),
        "5 13 20 15 30 11 2 18 29",
        "28 24 14",
        repeats=38,
    ),
    "pocketsdr_24MHz": Capture(
        "pocketsdr/L1_20211201_054600_24MHz_I.bin",
        *("real8", 24e6, 6e6, utc(2021, 12, 1, 5, 46, 0), TOKYO),
        "32 25 12 10 31 23 24 29",
        repeats=31,
    ),
    "sxnsr_flight": Capture(
        "sxnsr_flight/sxnsr_test_data_flight.stream",
        *("sxnsr", 20.48e6, 5499998.47412109, GpsTime(1672, 391_558_100_000_000)),
        np.array([3839479.7, 721777.3, 5025349.9, 18.19, -79.33, -11.43]),
        "23 32 17 13 20 31 1 11 4",
        "10 12 25",
        sums=26,
        navigation="sxnsr_flight/sxnsr_test_data_flight.12n",
        doppler_error_hz=10.0,
    ),
    "independent_sim": Capture(
        "independent_sim/still_40s_4MHz_1bit_iq.bin",
        *("independent_sim", 4e6, 0.0, GpsTime.from_calendar(2022, 1, 1, 2, 0, 0)),
        ecef_from_geodetic(np.array([np.radians(35.681298), np.radians(139.766247), 10.0])),
        "10 12 13 15 18 19 23 24 25 32",
        doppler_error_hz=10.0,
    ),
}


def baseband(raw, text, rate_hz, if_hz):
    packing = IfFormat.from_text(text)
    block = IfBlock(0, packing.samples_in(raw.size), rate_hz, if_hz, text, raw)
    return Baseband(packing, rate_hz, if_hz).convert(block)


def acquire(folder, capture, satellites=GPS, windows=None):
    acquirer = Acquirer(capture.rate_hz, AcquisitionConfig(noncoherent_count=capture.sums))
    count = IfFormat.from_text(capture.format).bytes_for(acquirer.samples_needed)
    raw = np.fromfile(folder / capture.path, np.uint8, count)
    i, q = baseband(raw, capture.format, capture.rate_hz, capture.if_hz)
    return acquirer.search(i, q, 0, satellites, windows)


def sky(folder, capture, seconds=0):
    """Return elevation [deg] and Doppler [Hz] of every satellite by the broadcast orbits."""
    time = capture.start.add_ns(capture.repeats * REPEAT_NS + seconds * 10**9)
    ephemerides = read_rinex_nav(folder / capture.navigation).ephemerides
    chosen = select_ephemerides(
        ephemerides, time.week, time.tow_ns, max_age_s=4 * 3600, healthy_only=False
    )
    view = line_of_sight(pack(list(chosen.values())), time.week, time.tow_ns, capture.position)
    return {
        name: (np.degrees(view.elevation[i]), view.doppler_hz[i]) for i, name in enumerate(chosen)
    }


def assert_up_and_moving_as_predicted(measured, predicted, error_hz):
    """All stand above the horizon, with one oscillator offset on their Dopplers."""
    offsets = {name: value - predicted[name][1] for name, value in measured.items()}
    middle = np.median(list(offsets.values()))
    assert all(abs(value - middle) < error_hz for value in offsets.values()), offsets
    elevations = {name: predicted[name][0] for name in measured}
    assert all(value > -1.0 for value in elevations.values()), elevations


@pytest.fixture(scope="module")
def if_captures(shared_data):
    return shared_data / "if_captures"


@pytest.fixture(scope="module")
def searched(if_captures):
    kept = {}

    def search(name):
        if name not in kept:
            kept[name] = acquire(if_captures, CAPTURES[name])
        return kept[name]

    return search


@pytest.mark.parametrize("name", CAPTURES)
def test_all_listed_satellites_are_acquired_and_none_is_false(searched, name):
    capture = CAPTURES[name]
    found = {item.satellite for item in searched(name) if item.detected}
    assert found == names(capture.listed) | names(capture.low)


@pytest.mark.parametrize("name", CAPTURES)
def test_every_detection_was_above_the_horizon_with_the_doppler_of_its_orbit(
    if_captures, searched, name
):
    capture = CAPTURES[name]
    measured = {d.satellite: d.carrier_doppler_hz for d in searched(name) if d.detected}
    predicted = sky(if_captures, capture)
    assert_up_and_moving_as_predicted(measured, predicted, capture.doppler_error_hz)


def test_dopplers_of_the_independent_signal_agree_with_its_truth(if_captures, searched):
    truth = np.load(if_captures / "independent_sim/still_truth.npz")
    expected = {
        f"G{prn:02d}": value
        for prn, value in zip(truth["prn"], truth["carrier_doppler_hz"].T[:, 5], strict=True)
    }
    for item in searched("independent_sim"):
        if item.detected:
            error = item.carrier_doppler_hz - expected[item.satellite]
            assert abs(error) < min(4 * item.doppler_sd_hz, 10.0), item


def test_warm_start_finds_the_same_in_a_tenth_of_the_rows(if_captures, searched):
    capture = CAPTURES["independent_sim"]
    ephemerides = read_rinex_nav(if_captures / capture.navigation).ephemerides
    windows = visible_windows(capture.position, capture.start, ephemerides, 400.0)
    warm = acquire(if_captures, capture, sorted(windows), windows)
    cold = {item.satellite: item for item in searched("independent_sim") if item.detected}
    assert {item.satellite for item in warm if item.detected} == set(cold)
    for item in warm:
        if item.detected:
            assert abs(item.carrier_doppler_hz - cold[item.satellite].carrier_doppler_hz) < 1.0


@pytest.mark.slow
def test_half_a_second_of_accumulation_adds_nothing_false(if_captures):
    capture = replace(CAPTURES["pocketsdr_4MHz"], sums=125)
    measured = {
        item.satellite: item.carrier_doppler_hz
        for item in acquire(if_captures, capture)
        if item.detected
    }
    assert set(measured) == names(capture.listed) | names(capture.low)
    assert_up_and_moving_as_predicted(measured, sky(if_captures, capture), 100.0)


def snapshots(folder, every):
    entries = json.loads((folder / "snappergps/snapshots_w00.json").read_text())["snapshots"]
    for second in range(0, len(entries), every):
        yield second, np.frombuffer(base64.b64decode(entries[second]["data"]), np.uint8)


def search_snapshots(folder, every):
    """Return for each satellite the seconds and Dopplers of its detections."""
    # 12 ms hold at most one bit edge: two coherent halves.
    config = AcquisitionConfig(coherent_ms=6, noncoherent_count=2)
    acquirer = Acquirer(4.092e6, config)
    hits = {}
    for second, raw in snapshots(folder, every):
        i, q = baseband(raw, "snappergps", 4.092e6, 4.092e6)
        for item in acquirer.search(i, q, 0):
            if item.detected:
                hits.setdefault(item.satellite, []).append((second, item.carrier_doppler_hz))
    return hits


@pytest.mark.parametrize("every", [20, pytest.param(1, marks=pytest.mark.slow)])
def test_snapshots_of_12_ms_give_the_listed_satellites_and_none_false(if_captures, every):
    hits = search_snapshots(if_captures, every)
    total = len(range(0, 301, every))
    for name in names("5 7 13 20 30"):
        assert len(hits[name]) > 0.8 * total
    # These five were up as well, at 7 to 25 deg; nothing else may appear.
    assert set(hits) <= names("5 7 13 20 30") | names("2 9 14 15 18")
    capture = Capture("", "", 0.0, 0.0, utc(2021, 11, 22, 12, 40, 0), OXFORD, "", repeats=40)
    first, last = sky(if_captures, capture), sky(if_captures, capture, seconds=300)
    for name, series in hits.items():
        assert first[name][0] > 5.0
        for second, doppler_hz in series:
            expected = first[name][1] + (last[name][1] - first[name][1]) * second / 300 - 640.0
            # Real samples: the sign is free. 640 Hz is the oscillator; 250 Hz, the old orbits.
            assert abs(abs(expected) - abs(doppler_hz)) < 250.0, (name, second, doppler_hz)
