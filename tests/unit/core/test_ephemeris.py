"""Broadcast orbit and clock against RTKLIB and their own numerical derivatives."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_core import ephemeris
from deepseis_core.ephemeris import ACCELERATION, CLOCK, CLOCK_RATE, POSITION, VELOCITY
from deepseis_core.types import Ephemeris

S = 10**9


def states(item: Ephemeris, tow_ns: int, delay: float = 0.0, week: int = 2190) -> np.ndarray:
    packed = ephemeris.pack([item])
    return ephemeris.satellite_states(packed, week, tow_ns, np.array([delay]))[0]


def test_position_and_clock_agree_with_rtklib(orbit):
    rtklib = pytest.importorskip("pyrtklib")
    theirs = rtklib.eph_t()
    pairs = {"A": orbit.sqrt_a**2, "e": orbit.eccentricity, "M0": orbit.m0, "i0": orbit.i0}
    pairs |= {"OMG0": orbit.omega0, "OMGd": orbit.omega_dot, "omg": orbit.omega}
    pairs |= {"deln": orbit.delta_n, "idot": orbit.i_dot, "toes": orbit.toe, "sat": 2}
    pairs |= {"f0": orbit.af0, "f1": orbit.af1, "f2": orbit.af2}
    pairs |= {name: getattr(orbit, name) for name in ("cuc", "cus", "crc", "crs", "cic", "cis")}
    for name, value in pairs.items():
        setattr(theirs, name, value)
    theirs.toe = theirs.toc = rtklib.gpst2time(2190, orbit.toe)
    position, clock, variance = (rtklib.Arr1Ddouble(n) for n in (3, 1, 1))
    for offset in range(-7200, 7201, 450):
        rtklib.eph2pos(
            rtklib.gpst2time(2190, orbit.toe + offset), theirs, position, clock, variance
        )
        ours = states(orbit, (518400 + offset) * S)
        # Same constants and equations: rounding only (2.6e7 m: 4e-9 m an operation).
        assert_allclose(ours[POSITION], [position[i] for i in range(3)], rtol=0, atol=1e-6)
        # F against -2 sqrt(GM)/c^2 differ in the tenth digit of 50 ns.
        assert_allclose(ours[CLOCK] + orbit.tgd, clock[0], rtol=0, atol=1e-16)


@pytest.mark.parametrize("offset_s", [-7000, 0, 1234, 7000])
def test_velocity_acceleration_and_clock_rates_are_the_derivatives(orbit, offset_s):
    tow_ns, h = (518400 + offset_s) * S, 1
    ahead, behind = states(orbit, tow_ns + h * S), states(orbit, tow_ns - h * S)
    now = states(orbit, tow_ns)
    # Truncation h^2/6 times the third derivative, w^3 r = 8e-5 m/s^3 (and w^4 r).
    assert_allclose((ahead - behind)[POSITION] / (2 * h), now[VELOCITY], rtol=0, atol=3e-5)
    assert_allclose((ahead - behind)[VELOCITY] / (2 * h), now[ACCELERATION], rtol=0, atol=1e-8)
    assert_allclose((ahead - behind)[CLOCK] / (2 * h), now[CLOCK_RATE], rtol=0, atol=1e-18)
    curvature = (ahead - behind)[CLOCK_RATE] / (2 * h)
    assert_allclose(curvature, now[ephemeris.CLOCK_ACCELERATION], rtol=0, atol=1e-22)


def test_time_is_exact_to_nanoseconds_and_delays_subtract(orbit):
    one = states(orbit, 520000 * S, 0.07)
    same = states(orbit, 520000 * S - 70_000_000)
    assert_allclose(one, same, rtol=0, atol=2e-8)
    step = states(orbit, 520000 * S + 1) - states(orbit, 520000 * S)
    velocity = states(orbit, 520000 * S)[VELOCITY]
    # 1 ns of flight is 3 um; coordinates round to 4 nm and trigonometry to a few of them.
    assert_allclose(step[POSITION], velocity * 1e-9, rtol=0, atol=3e-8)


def test_toe_in_the_week_after_is_a_step_of_nothing(orbit):
    item = dataclasses.replace(orbit, week=2191, toe=0.0, toc=0.0)
    before = states(item, 604799 * S, week=2190)
    assert_allclose(before, states(item, -1 * S, week=2191), rtol=0, atol=0)
    split = dataclasses.replace(item, toc=604784.0)  # toc in the week before toe
    shift = states(split, 0, week=2191)[CLOCK] - states(item, 0, week=2191)[CLOCK]
    assert_allclose(shift, 16 * item.af1 + 256 * item.af2, rtol=1e-3)


def test_states_from_pseudoranges_solve_for_the_time_of_departure(orbit):
    packed = ephemeris.pack([orbit])
    travel, error = 0.0731, 4.2e-3  # flight [s], receiver clock ahead [s]
    tow_ns = 520000 * S
    departure = states(orbit, tow_ns, travel)
    pseudorange = (travel + error - departure[CLOCK]) * 299792458.0
    found = ephemeris.states_from_pseudoranges(
        packed, 2190, tow_ns + round(error * S), np.array([pseudorange])
    )[0]
    assert_allclose(found[POSITION], departure[POSITION], rtol=0, atol=1e-7)


def test_the_nearest_healthy_ephemeris_is_chosen(orbit):
    later = dataclasses.replace(orbit, toe=525600.0, toc=525600.0)
    resent = dataclasses.replace(orbit, transmit_tow=515000.0, iode=9)
    ill = dataclasses.replace(orbit, satellite="G03", health=63)
    candidates = [later, orbit, resent, ill]

    def select(tow_s: int, **options: bool) -> dict[str, Ephemeris]:
        return ephemeris.select_ephemerides(candidates, 2190, tow_s * S, **options)

    assert select(521999)["G02"] is resent
    assert select(522001)["G02"] is later
    assert list(select(520000)) == ["G02"]
    assert list(select(520000, healthy_only=False)) == ["G02", "G03"]
    assert select(525600 + 7201) == {}
