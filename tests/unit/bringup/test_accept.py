import csv
from dataclasses import replace

import numpy as np
import pytest

from deepseis_bringup.accept.loop_measures import (
    CarrierTruth,
    Tracks,
    measure,
    phase_errors,
    pooled,
    thermal_deg,
)
from deepseis_bringup.accept.tables import COLUMNS, Acceptance, Goal, Row
from deepseis_bringup.commands.accept import REPEATED, repeater
from deepseis_bringup.report.plot import Figure, Panel
from deepseis_core.errors import InputError
from deepseis_core.types import TrackingEpochs, TrackingFlag, TrackingMode

RATE = 4e6
LOCKED = int(TrackingFlag.PHASE_LOCK | TrackingFlag.BIT_SYNC | TrackingFlag.CODE_LOCK)


@pytest.mark.parametrize(
    ("goal", "good", "bad"),
    [
        (Goal.at_most(1.1), 1.1, 1.11),
        (Goal.at_least(0.4), 0.4, 0.39),
        (Goal.within(0.15, 29.0), 33.3, 33.4),
    ],
)
def test_a_goal_is_met_up_to_its_limit(goal, good, bad):
    assert goal.met(good)
    assert not goal.met(bad)
    assert not goal.met(float("nan"))


def test_the_csv_has_the_promised_columns_and_says_what_is_missed(tmp_path):
    acceptance = Acceptance("x", "A <test>")
    acceptance.add(
        Row("t", "s", "a", "deg", 2.0, 1.5, Goal.at_most(1.0), 0.5),
        Row("t", "s", "b", "deg", 0.5, None, Goal.at_most(1.0)),
        Row("t", "s", "c", "deg", None),
    )
    acceptance.write(tmp_path)
    with (tmp_path / "x.csv").open() as file:
        lines = list(csv.reader(file))
    assert tuple(lines[0]) == COLUMNS
    assert lines[1][4:] == ["1.5", "2", "<= 1", "0.5", "no"]
    assert [line[-1] for line in lines[1:]] == ["no", "yes", ""]
    assert acceptance.counts() == (1, 2)
    page = (tmp_path / "x.html").read_text()
    assert "A &lt;test&gt;" in page
    assert "1 of 2 goals" in page


def test_pictures_stand_behind_their_table_and_numbers_are_not_broken():
    acceptance = Acceptance("x", "X")
    acceptance.add(Row("first", "s", "a", "deg", 2.0), Row("second", "s", "b", "deg", 0.5))
    panel = Panel([], {})
    for title in ("drawn", "drawn too"):
        acceptance.figures.append(("first", [Figure(title, "", [panel])]))
    acceptance.figures.append(("without a table", [Figure("apart", "", [panel])]))
    page = acceptance.page()
    places = [
        page.index(text)
        for text in (">first<", ">drawn<", ">drawn too<", ">second<", ">without a table<")
    ]
    assert places == sorted(places)
    assert '<td style="white-space:nowrap">0.5</td>' in page


def epochs(satellite, phase, noise, *, flags=LOCKED, cn0=45.0):
    """Integrations of 20 ms that follow ``phase(t)`` [cycles] but for constant errors."""
    count = len(noise)
    start = np.arange(count, dtype=np.int64) * 80_000
    t = start / RATE
    zeros = np.zeros(count, np.float32)
    step = 0.02
    doppler = (phase(t + step) - phase(t)) / step
    names = ("early_i", "early_q", "prompt_i", "prompt_q", "late_i", "late_q")
    return TrackingEpochs(
        satellite=satellite,
        block_sample_index=0,
        valid_through=int(start[-1]) + 79_999,
        ephemeris_count=0,
        mode=int(TrackingMode.TRACK),
        sample_index=start,
        sample_count=np.full(count, 80_000, np.int32),
        transmit_ms=np.zeros(count, np.int64),
        code_phase_chips=zeros.astype(float),
        code_rate_cps=zeros.astype(float),
        carrier_phase_cycles=phase(t) + noise,
        carrier_doppler_hz=doppler,
        carrier_doppler_rate=zeros.astype(float),
        carrier_doppler_accel=zeros.astype(float),
        **dict.fromkeys(names, zeros),
        carrier_error_cycles=noise.astype(np.float32),
        code_error_chips=zeros,
        cn0_dbhz=zeros + cn0,
        phase_lock_indicator=zeros + 1,
        aid_doppler_hz=zeros,
        aid_age_s=zeros,
        flags=np.full(count, flags, np.uint16),
    )


@pytest.fixture
def made():
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 20.0, 0.01)
    common = 0.02 * rng.standard_normal(1000)
    slopes = (100.0, -250.0, 40.0)
    noise = [0.004 * rng.standard_normal(1000) for _ in slopes]
    noise[1][500:] *= 3.0
    tracks = Tracks()
    for k, slope in enumerate(slopes):
        tracks.add(epochs(f"G0{k + 1}", lambda t, s=slope: s * t + 7.0, noise[k] + common))
    phase = np.stack([slope * t for slope in slopes], axis=1)
    truth = CarrierTruth(
        ("G01", "G02", "G03"), t, phase, np.full((t.size, 3), 45.0), np.radians([60.0, 25.0, 40.0])
    )
    return tracks.finish(), truth, common, noise


def test_errors_against_truth_are_those_put_in(made):
    tracks, truth, common, noise = made
    for span, part in (((2.0, 9.9), slice(100, 495)), ((10.1, 19.9), slice(505, 995))):
        found = measure(tracks, truth, RATE, span, (2.0, 9.9))
        for figures, own in zip(found, noise, strict=True):
            put_in = own[part] + common[part]
            assert figures.error_rms == pytest.approx(360 * np.sqrt(np.mean(put_in**2)), rel=0.03)
            assert figures.locked == 1.0
            assert figures.slips == 0


def test_the_common_part_is_taken_away(made):
    # Of three satellites each keeps two thirds of its own variance; the rest is put back.
    tracks, truth, _, noise = made
    found = measure(tracks, truth, RATE, (2.0, 9.9), (2.0, 9.9))
    total = pooled(figures.own_rms for figures in found)
    put_in = 360 * np.sqrt(np.mean([np.mean(own[100:495] ** 2) for own in noise]))
    assert total == pytest.approx(put_in, rel=0.05)


def test_slips_and_lost_lock_are_counted(made):
    _, truth, common, noise = made
    tracks = Tracks()
    bad = int(TrackingFlag.BIT_SYNC | TrackingFlag.SLIP)
    tracks.add(epochs("G01", lambda t: 100.0 * t, noise[0] + common, flags=bad))
    (figures,) = measure(tracks.finish(), truth, RATE, (10.0, 12.0), (2.0, 9.9))
    assert figures.slips == 100
    assert figures.locked == 0.0
    assert np.isnan(figures.error_rms)
    assert np.isfinite(figures.discriminator_rms)


def test_thermal_noise_at_the_papers_values():
    # 8 Hz, 20 ms, 45 dB-Hz: 0.912 deg (thesis 3.2).
    assert thermal_deg(8.0, 45.0) == pytest.approx(0.912, abs=0.001)


def test_a_half_cycle_put_in_for_polarity_is_no_error(made):
    _, truth, _, noise = made
    turned = np.zeros(1000)
    turned[600:] = 0.5
    part = epochs("G01", lambda t: 100.0 * t, noise[0] + turned)
    flags = part.flags.copy()
    flags[600] |= int(TrackingFlag.HALF_CYCLE)
    for shown, expected in ((flags, 0.0), (part.flags, 0.5)):
        tracks = Tracks()
        tracks.add(replace(part, flags=shown))
        error = phase_errors(tracks.finish(), truth, RATE)[:, 0]
        step = np.nanmean(error[1210:1990]) - np.nanmean(error[400:1190])
        # Means of 8 s of 0.004 cycles, 400 integrations.
        assert step == pytest.approx(expected, abs=0.002)


@pytest.mark.parametrize("name", REPEATED)
def test_everything_that_can_be_repeated_is_found(name):
    assert callable(repeater(name))


def test_a_table_that_nobody_knows_is_refused():
    with pytest.raises(InputError, match="gyrofree"):
        repeater("thesis")
