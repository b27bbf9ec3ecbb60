"""One reflection: where it comes from, and what it does to correlators of the signal."""

import dataclasses

import numpy as np
import pytest

from deepseis_core.ca_code import ca_code
from deepseis_core.constants import CA_RATE_CPS, L1_WAVELENGTH, SPEED_OF_LIGHT
from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.gps_time import GpsTime
from deepseis_core.if_format import IfFormat
from deepseis_sim.constellation import visible_satellites
from deepseis_sim.if_synthesis import IfSynthesizer
from deepseis_sim.multipath import MultipathConfig, composite_phase_error
from deepseis_sim.nominal_constellation import nominal_constellation
from deepseis_sim.signal_model import SignalModel, still

TIME = GpsTime(2399, 346258 * 10**9)
TOKYO = ecef_from_geodetic([np.deg2rad(35.681298), np.deg2rad(139.766247), 10.0])
VISIBLE = visible_satellites(nominal_constellation(TIME), TIME, TOKYO)
RATE = 16.1e6  # no whole number of samples in a chip: correlation has no steps
CHIP = SPEED_OF_LIGHT / CA_RATE_CPS


def mirror_point_delay(direction, normal, distance):
    """Length of the broken way less the direct one, by the law of reflection, in the plane."""
    foot = -distance * normal  # the plane, seen from the antenna at the origin
    mirrored = direction - 2 * (direction @ normal) * normal
    # The ray arrives at the antenna going along -mirrored: back along it to the plane.
    reach = (foot @ normal) / (mirrored @ normal)
    point = reach * mirrored
    return np.linalg.norm(point) - point @ direction


@pytest.mark.parametrize("reflector", ["ground", "wall"])
def test_the_extra_way_is_that_of_the_law_of_reflection(reflector):
    config = MultipathConfig(reflector=reflector, distance=3.7, azimuth_deg=70.0)
    elevation, azimuth = np.deg2rad(35.0), np.deg2rad(290.0)
    flat = np.cos(elevation)
    u = np.array([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)])
    away = np.deg2rad(70.0)
    normal = {"ground": [0.0, 0.0, 1.0], "wall": [-np.sin(away), -np.cos(away), 0.0]}[reflector]
    expected = mirror_point_delay(u, np.array(normal), 3.7)
    assert config.extra_path(elevation, azimuth) == pytest.approx(expected, abs=1e-12)
    if reflector == "ground":
        assert expected == pytest.approx(2 * 3.7 * np.sin(elevation))


def correlate(k, multipath, shifts, model=None):
    """Correlate 20 ms of satellite k and its reflection, at shifts of the replica [chips]."""
    model = model or SignalModel([VISIBLE[k]], TIME, still(TOKYO))
    synthesizer = IfSynthesizer(
        IfFormat.from_text("iq16"), RATE, 0.0, model.signal_prn(multipath), noise=False,
        mean_cn0_dbhz=[45.0],
    )  # fmt: skip
    segments = model.segments(0, 3, synthesizer.segment_span, multipath)
    time = np.arange(round(0.02 * RATE)) / RATE
    i, q = synthesizer.levels(segments, 0, time.size)
    knots = np.arange(3) * 0.02 - 0.01
    delays = model.delays(knots)
    phase = np.polyfit(knots, delays.carrier_phase_cycles[:, 0] % 2**20, 2)
    sent = time - np.polyval(np.polyfit(knots, delays.pseudorange[:, 0], 2), time) / SPEED_OF_LIGHT
    turn = np.polyval(phase, time) + model.initial_phase_cycles[0]
    bit = np.floor(sent / 0.02)
    within = bit == np.median(bit)  # most of one data bit
    mixed = ((i + 1j * q) * np.exp(-2j * np.pi * turn))[within]
    chip = 1.023e6 * (sent[within] % 1e-3)
    code = ca_code(VISIBLE[k].prn)
    replicas = (code[np.floor(chip + shift).astype(int) % 1023] for shift in shifts)
    return np.array([(mixed * replica).mean() for replica in replicas])


def triangle(x):
    return np.maximum(0.0, 1.0 - np.abs(x))


@pytest.mark.parametrize("height", np.linspace(40.0, 40.2, 5))
@pytest.mark.parametrize("k", [5, 8])
def test_phase_error_of_the_prompt_is_the_closed_form(k, height):
    multipath = MultipathConfig(distance=height, amplitude=0.5)
    (prompt,) = correlate(k, multipath, [0.0])
    (alone,) = correlate(k, None, [0.0])
    extra = 2 * height * np.sin(VISIBLE[k].elevation)
    weight = 0.5 * triangle(extra / CHIP)
    assert weight > 0.1
    measured = np.angle(prompt / alone) / (2 * np.pi)
    turn = -extra / L1_WAVELENGTH + 0.5
    # Edges of chips fall on samples: each 20 ms know the correlation to about 2e-3.
    assert measured == pytest.approx(composite_phase_error(weight, turn), abs=6e-4)
    theta = 2 * np.pi * turn
    plain = np.arctan2(weight * np.sin(theta), 1 + weight * np.cos(theta)) / (2 * np.pi)
    assert measured == pytest.approx(plain, abs=6e-4)


@pytest.mark.parametrize("in_phase", [True, False])
def test_code_error_reaches_the_envelope_of_the_early_minus_late_correlator(in_phase):
    # Kaplan and Hegarty, section 6.2: a d / 2 chips plateau when the reflection is in phase and
    # late enough: for spacing d and amplitude a, error = + a d / 2 (or -a d / 2).
    spacing, amplitude, k = 0.5, 0.5, 5
    sine = np.sin(VISIBLE[k].elevation)
    turns = round(2 * 200.0 * sine / L1_WAVELENGTH) + (0.5 if in_phase else 0.0)
    height = turns * L1_WAVELENGTH / (2 * sine)
    assert spacing / 2 * 1.5 < 2 * height * sine / CHIP < 1 - spacing / 2
    multipath = MultipathConfig(distance=height, amplitude=amplitude)
    shifts = np.linspace(-0.2, 0.2, 41)
    early = np.abs(correlate(k, multipath, shifts + spacing / 2))
    late = np.abs(correlate(k, multipath, shifts - spacing / 2))
    balance = early - late
    crossing = np.flatnonzero(np.diff(np.sign(balance)))[0]
    share = balance[crossing] / (balance[crossing] - balance[crossing + 1])
    # A replica that is shifted forward is early: the delay it measures is minus the shift.
    delay = -(shifts[crossing] + share * (shifts[1] - shifts[0]))
    expected = amplitude * spacing / 2 * (1 if in_phase else -1)
    assert delay == pytest.approx(expected, abs=0.01)  # 16 samples a chip


def test_behind_the_wall_nothing_is_reflected_and_others_can_be_spared():
    model = SignalModel(VISIBLE, TIME, still(TOKYO))
    count = len(VISIBLE)
    wall = MultipathConfig(reflector="wall", azimuth_deg=np.rad2deg(VISIBLE[2].azimuth))
    cn0 = model.segments(0, 2, 0.01, wall).cn0_dbhz[count:]
    assert np.isinf(cn0[2]).all()
    behind = np.cos([v.azimuth - VISIBLE[2].azimuth for v in VISIBLE]) > 0
    np.testing.assert_array_equal(np.isinf(cn0[:, 0]), behind)
    chosen = MultipathConfig(satellites=(VISIBLE[1].satellite,))
    assert model.signal_prn(chosen) == [*(v.prn for v in VISIBLE), VISIBLE[1].prn]
    segments = model.segments(0, 2, 0.01, chosen)
    assert segments.cn0_dbhz.shape == (count + 1, 2)
    expected = VISIBLE[1].cn0_dbhz + 20 * np.log10(0.3)
    np.testing.assert_allclose(segments.cn0_dbhz[-1], expected)
    np.testing.assert_array_equal(segments.bits[-1], segments.bits[1])


def test_without_a_reflection_nothing_changes():
    model = SignalModel(VISIBLE, TIME, still(TOKYO))
    plain = model.segments(3, 4, 0.01)
    silent = model.segments(3, 4, 0.01, MultipathConfig(amplitude=0.0))
    for item in dataclasses.fields(plain):
        value = getattr(silent, item.name)
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(value[: len(VISIBLE)], getattr(plain, item.name))
    assert np.isinf(silent.cn0_dbhz[len(VISIBLE) :]).all()
