"""The synthesised carrier against an outside evaluation in extended precision, under dynamics."""

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from unit.sim.precise_signal import REAL, received

from deepseis_core.ca_code import ca_code
from deepseis_core.geodesy import ecef_from_geodetic, rotation_enu_ecef
from deepseis_core.gps_time import GpsTime
from deepseis_core.if_format import IfFormat
from deepseis_sim.constellation import visible_satellites
from deepseis_sim.if_synthesis import IfSynthesizer
from deepseis_sim.nominal_constellation import nominal_constellation
from deepseis_sim.signal_model import SignalModel, linear_clock

TOW = 346258
TIME = GpsTime(2399, TOW * 10**9)
PLACE = np.deg2rad(35.681298), np.deg2rad(139.766247)
ORIGIN = ecef_from_geodetic([*PLACE, 10.0])
EAST, NORTH, UP = rotation_enu_ecef(*PLACE)
BIAS, DRIFT = 3.2e-4, 8e-8
G = 9.80665
VISIBLE = visible_satellites(nominal_constellation(TIME), TIME, ORIGIN)
PER_SECOND = 10_000  # values of the phase


def burst(t):
    """Return the way [m] of: rest to 1 s, 25 g/s for 2 s, 50 g for 3 s, -25 g/s for 2 s."""
    way = 0 * t
    for corner, jerk in ((1, 25), (3, -25), (6, -25), (8, 25)):
        way = way + jerk * type(t[0])(G) / 6 * np.where(t > corner, t - corner, 0) ** 3
    return way


def moved(way):
    """Turn a way along two axes into the antenna's trajectory, in any precision."""

    def antenna(t):
        return sum(axis[:, None] * part for axis, part in way(t)) + ORIGIN[:, None]

    return antenna


def sine(frequency_hz):
    radius = 2 * G / (2 * np.pi * frequency_hz) ** 2

    def way(t):
        turn = 2 * type(t[0])(np.pi) * frequency_hz * t
        return [(EAST, radius * np.sin(turn)), (NORTH, radius * (np.cos(turn) - 1))]

    return way


MOTIONS = {
    "50 g": (lambda t: [(0.6 * EAST + 0.8 * UP, burst(t))], (0.95, 2.95, 4.5, 5.95, 7.95)),
    "2 g at 2 Hz": (sine(2.0), (0.0, 0.3)),
    "2 g at 10 Hz": (sine(10.0), (0.0, 0.05)),
}


def model_of(antenna, satellites):
    return SignalModel(
        satellites,
        TIME,
        lambda time: antenna(time).T,
        clock=linear_clock(BIAS, DRIFT),
        ionosphere=False,
        troposphere=False,
    )


def outside(antenna, k, time):
    phase, sent = received(VISIBLE[k].ephemeris, TOW, antenna, time, BIAS, DRIFT)
    return phase, sent


@pytest.mark.parametrize("name", MOTIONS)
def test_the_models_phase_is_that_of_the_outside_evaluation(name):
    way, begins = MOTIONS[name]
    antenna = moved(way)
    model = model_of(antenna, VISIBLE)
    time = np.concatenate([np.linspace(t, t + 0.1, 101) for t in begins])
    ours = model.carrier_phase_cycles(time) - model.initial_phase_cycles
    worst = 0.0
    for k in range(len(VISIBLE)):
        phase, _ = outside(antenna, k, time.astype(REAL))
        worst = max(worst, float(np.abs(phase - ours[:, k]).max()))
    # Doubles: 1.2e8 cycles of range keep 1.5e-8, satellite positions of 2.7e7 m 4e-9 m (2e-8).
    assert worst < 3e-7


@pytest.mark.parametrize(
    ("name", "k", "rate"),
    [*((name, k, 4e6) for name in MOTIONS for k in (1, 4)), ("50 g", 4, 1.3e6)],
)
def test_samples_carry_that_phase_to_a_thousandth_of_a_cycle(name, k, rate):
    way, begins = MOTIONS[name]
    antenna = moved(way)
    # So strong the carrier fills 16 bits (28963 levels): 1e-5 cycle of rounding in a sample.
    strong = dataclasses.replace(VISIBLE[k], cn0_dbhz=10 * np.log10(25 * rate))
    model = model_of(antenna, [strong])
    synthesizer = IfSynthesizer(
        IfFormat.from_text("iq16"), rate, 0.0, [VISIBLE[k].prn], noise=False
    )
    span, length = synthesizer.segment_span, synthesizer.segment_samples
    worst, block = 0.0, round(rate / PER_SECOND)
    for begin in begins:
        first = round(begin / span)
        i, q = synthesizer.levels(model.segments(first, 10, span), first * length, 10 * length)
        number = first * length + np.arange(i.size)
        time = number / rate
        knots = np.arange(time[0] - 1e-3, time[-1] + 1e-3, 2.5e-4)
        phase, sent = outside(antenna, k, knots.astype(REAL))
        phase += model.initial_phase_cycles[0]
        # Splines through differences from a straight line: doubles keep all digits of these.
        turns, dopplers = phase[0], (phase[-1] - phase[0]) / REAL(knots[-1] - knots[0])
        rest = phase - turns - dopplers * (knots.astype(REAL) - REAL(knots[0]))
        whole = turns + dopplers * (time.astype(REAL) - REAL(knots[0]))
        turn = (whole % 1).astype(float) + CubicSpline(knots, rest.astype(float))(time)
        late = CubicSpline(knots, (sent - knots.astype(REAL)).astype(float))(time)
        chips = np.floor(1.023e6 * ((time + late) % 1e-3)).astype(int) % 1023
        mixed = (i + 1j * q) * ca_code(VISIBLE[k].prn)[chips] * np.exp(-2j * np.pi * turn)
        prompt = mixed[: i.size // block * block].reshape(-1, block).mean(axis=1)
        prompt = prompt[np.abs(prompt) > 0.5 * np.abs(prompt).max()]  # no data edge within
        error = np.angle(prompt**2) / 2 / (2 * np.pi)  # data bits squared away
        worst = max(worst, float(np.abs(error).max()))
    # The chord of a tile, while 50 g turn the Doppler by 2577 Hz/s: 2.1e-5 cycle at 4 MHz.
    assert worst < 1.2 * 2577 * (1024 / rate) ** 2 / 8
