"""Line of sight, Doppler and atmosphere: RTKLIB, a simulator's truth, numerical derivatives."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_core import atmosphere, ephemeris, geodesy
from deepseis_core.constants import L1_HZ, SPEED_OF_LIGHT
from deepseis_core.propagation import line_of_sight
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.types import FloatArray

S = 10**9
TOW_NS = 521_000 * S
STATION = geodesy.ecef_from_geodetic([np.radians(35.681298), np.radians(139.766247), 10.0])


@pytest.fixture
def packed(orbit) -> FloatArray:
    """Eight satellites around the orbit's plane and node."""
    items = [
        dataclasses.replace(orbit, m0=0.8 * i, omega0=1.1 * i, satellite=f"G{i + 1:02d}")
        for i in range(8)
    ]
    return ephemeris.pack(items)


def shaken(t: np.ndarray) -> np.ndarray:
    """Return ECEF position, velocity, acceleration of 12 cm at 2 Hz (1.9 g) on 20 m/s."""
    w, amplitude = 2 * np.pi * 2.0, 0.12
    axes = np.array([[0.6, 0.64, 0.48], [0.8, -0.48, -0.36]])
    phase = np.stack([np.cos(w * t), np.sin(w * t)], -1)
    slope = np.stack([-np.sin(w * t), np.cos(w * t)], -1)
    drive = np.array([12.0, -16.0, 0.0])
    position = STATION + amplitude * phase @ axes + t[:, None] * drive
    velocity = amplitude * w * slope @ axes + drive
    return np.concatenate([position, velocity, -amplitude * w**2 * phase @ axes], axis=-1)


def test_range_and_direction_agree_with_rtklib(packed):
    rtklib = pytest.importorskip("pyrtklib")
    los = line_of_sight(packed, 2190, TOW_NS, STATION)
    states = ephemeris.satellite_states(packed, 2190, TOW_NS, los.range / SPEED_OF_LIGHT)
    place = geodesy.geodetic_from_ecef(STATION)

    def array(values: FloatArray) -> object:
        out = rtklib.Arr1Ddouble(len(values))
        for i, value in enumerate(values):
            out[i] = float(value)
        return out

    for i, state in enumerate(states):
        unit, azel = rtklib.Arr1Ddouble(3), rtklib.Arr1Ddouble(2)
        distance = rtklib.geodist(array(state[:3]), array(STATION), unit)
        # RTKLIB takes the Earth's rotation to first order: (w tau)^2 r = 1 mm at most is left,
        # and its direction ignores it (w tau = 7.3e-6 rad at 0.1 s, below the horizon).
        assert abs(distance - los.range[i]) < 1e-3
        assert_allclose(-los.unit[i], [unit[k] for k in range(3)], rtol=0, atol=7.3e-6)
        rtklib.satazel(array(place), array(-los.unit[i]), azel)
        assert_allclose([los.azimuth[i], los.elevation[i]], [azel[0], azel[1]], atol=1e-12)


def test_the_signal_arrives_when_light_would(packed):
    los = line_of_sight(packed, 2190, TOW_NS, STATION)
    # In inertial axes that coincide with ECEF at reception the flight is a straight line.
    flight = np.linalg.norm(los.satellite_position - STATION, axis=-1) / SPEED_OF_LIGHT
    assert_allclose(flight, los.range / SPEED_OF_LIGHT, rtol=1e-15)
    states = ephemeris.satellite_states(packed, 2190, TOW_NS, flight)
    radius = np.linalg.norm(states[:, :3], axis=-1)
    assert_allclose(np.linalg.norm(los.satellite_position, axis=-1), radius, rtol=1e-15)


def test_rates_are_the_derivatives_of_range_for_a_shaken_receiver(packed):
    h = 1e-3
    t = np.arange(-500, 501) * h
    tow_ns = TOW_NS + np.rint(t * S).astype(np.int64)
    los = line_of_sight(packed, 2190, tow_ns, shaken(t))
    middle = slice(1, -1)
    rate = (los.range[2:] - los.range[:-2]) / (2 * h)
    second = (los.range_rate[2:] - los.range_rate[:-2]) / (2 * h)
    # h^2/6 times jerk (240 m/s^3) is 4e-5 m/s, and rounding 2e-8 m / 2 ms; one order up 5e-4.
    assert_allclose(los.range_rate[middle], rate, rtol=0, atol=6e-5)
    assert_allclose(los.range_acceleration[middle], second, rtol=0, atol=6e-4)
    assert np.ptp(los.range_acceleration[:, 0]) > 5  # m/s^2: the shaking is in it


def test_range_acceleration_is_exact_to_rounding_where_the_motion_is_smooth(packed):
    moving = np.concatenate([STATION, [30.0, -20.0, 10.0], np.zeros(3)])
    t = np.arange(-3, 4) * 1.0
    rows = np.tile(moving, (t.size, 1))
    rows[:, :3] += t[:, None] * moving[3:6]
    los = line_of_sight(packed, 2190, TOW_NS + (t * S).astype(np.int64), rows)
    five_point = np.array([0, 1, -8, 0, 8, -1, 0]) / 12.0
    # Truncation of the five-point rule, w^5 r = 2e-12; rounding of range 4e-9 m.
    assert_allclose(five_point @ los.range, los.range_rate[3], rtol=0, atol=2e-8)
    assert_allclose(five_point @ los.range_rate, los.range_acceleration[3], rtol=0, atol=1e-11)
    assert_allclose(five_point @ los.doppler_hz, los.doppler_rate[3], rtol=0, atol=1e-10)


def test_doppler_is_the_derivative_of_the_received_carrier(packed):
    t = np.arange(-2, 3) * 1.0
    los = line_of_sight(packed, 2190, TOW_NS + (t * S).astype(np.int64), STATION)
    phase = L1_HZ * (los.satellite_clock - los.range / SPEED_OF_LIGHT)
    five_point = np.array([1, -8, 0, 8, -1]) / 12.0
    # Rounding: 1.2e8 cycles keep 1.5e-8, range 4e-9 m is 2e-8 cycles.
    assert_allclose(five_point @ phase, los.doppler_hz[2], rtol=0, atol=2e-7)


def test_to_first_order_doppler_is_that_of_the_textbook(packed):
    receiver = shaken(np.zeros(1))[0]
    los = line_of_sight(packed, 2190, TOW_NS, receiver)
    states = ephemeris.satellite_states(packed, 2190, TOW_NS, los.range / SPEED_OF_LIGHT)
    relative = receiver[3:6] - states[:, 3:6]
    textbook = -np.sum(los.unit * relative, axis=-1) * L1_HZ / SPEED_OF_LIGHT
    textbook += L1_HZ * los.satellite_clock_rate
    # Left out: turning of the axes (5.5e-6 of 3 km/s: 0.1 Hz) and v/c (1e-5 of 5 kHz: 0.05 Hz).
    assert_allclose(los.doppler_hz, textbook, rtol=0, atol=0.2)


def test_offset_moves_the_time_and_shapes_follow_the_arguments(packed):
    one = line_of_sight(packed, 2190, TOW_NS, STATION, offset=1e-3)
    two = line_of_sight(packed, 2190, TOW_NS + 1_000_000, STATION)
    assert_allclose(one.range, two.range, rtol=0, atol=1e-7)
    assert one.range.shape == (8,)
    assert one.unit.shape == (8, 3)
    many = line_of_sight(packed, 2190, [TOW_NS, TOW_NS + S], STATION)
    assert many.doppler_hz.shape == (2, 8)
    assert_allclose(many.range[0], line_of_sight(packed, 2190, TOW_NS, STATION).range, rtol=0)


def test_a_public_simulator_has_the_same_phase_and_direction(shared_data):
    folder = shared_data / "if_captures/independent_sim"
    truth = np.load(folder / "still_truth.npz")
    nav = read_rinex_nav(folder / "brdc0010.22n")
    start_ns = 525_600 * S
    best = ephemeris.select_ephemerides(nav.ephemerides, 2190, start_ns)
    packed = ephemeris.pack([best[f"G{prn:02d}"] for prn in truth["prn"]])
    every = slice(0, 4001, 100)
    tow_ns = start_ns + np.rint(truth["t_s"][every] * S).astype(np.int64)
    los = line_of_sight(packed, 2190, tow_ns, STATION)
    # The simulator's own printing: 0.001 deg.
    assert_allclose(np.degrees(los.elevation[0]), truth["el_deg"], rtol=0, atol=1e-3)
    assert_allclose(np.degrees(los.azimuth[0]), truth["az_deg"], rtol=0, atol=1e-3)
    place = geodesy.geodetic_from_ecef(STATION)
    iono = np.array(
        [
            atmosphere.klobuchar_delay(
                np.array(nav.iono_alpha),
                np.array(nav.iono_beta),
                place[0],
                place[1],
                los.elevation[k],
                los.azimuth[k],
                tow_ns[k] / S,
            )
            for k in range(tow_ns.size)
        ]
    )
    # It delays the carrier too (its README), and takes Sagnac to first order.
    phase = L1_HZ * (los.satellite_clock - (los.range + iono) / SPEED_OF_LIGHT)
    theirs = truth["carrier_phase_cycles"][every]
    difference = (phase - phase[0]) - (theirs - theirs[0])
    assert np.abs(difference).max() < 1e-3
