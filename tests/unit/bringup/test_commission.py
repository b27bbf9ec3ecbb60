"""A new station, simulated, with one thing wrong at a time: the check that is to find it does."""

from dataclasses import replace

import allantools
import numpy as np
import pytest
from fusion_bench import FusionBench, precise_positions

from deepseis_bringup.commission import commissioning
from deepseis_bringup.commission.checks import FAIL, OPEN, PASS, Check, allan
from deepseis_bringup.commission.commissioning import all_checks, page, verdict
from deepseis_bringup.commission.data import StationData
from deepseis_core.rotation import matrix_from_rotvec
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import PreciseStatus, PvtStatus

TILTS = [
    {"kind": "tilt", "pitch_deg": 4.0, "heading_deg": 6.0, "start": 15.0, "rise": 1.5},
    {"kind": "tilt", "roll_deg": 5.0, "heading_deg": -12.0, "start": 18.0, "rise": 1.5},
    {"kind": "tilt", "pitch_deg": -8.0, "start": 21.0, "rise": 2.0},
    {"kind": "tilt", "roll_deg": -10.0, "heading_deg": 6.0, "start": 25.0, "rise": 2.0},
    {"kind": "tilt", "pitch_deg": 4.0, "roll_deg": 5.0, "start": 29.0, "rise": 2.0},
]


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Sines of 0.2 g along three axes, and tilting to and fro."""
    import yaml

    motion = [
        {"kind": "sine", "amplitude": 0.06, "frequency_hz": f, "start": 14.0, "duration": 21.0,
         "ramp": 2.0, **way}
        for f, way in (
            (0.9, {"azimuth_deg": 70.0}), (1.1, {"azimuth_deg": 160.0}),
            (1.0, {"elevation_deg": 90.0, "amplitude": 0.04}),
        )
    ]  # fmt: skip
    path = tmp_path_factory.mktemp("scenario") / "commission.yaml"
    whole = {"duration": 36.0, "motion": [*motion, *TILTS], "short": {"duration": 36.0}}
    path.write_text(yaml.safe_dump(whole))
    run = FusionBench(str(path), "span-fsas")
    clock = SampleClock(run.bench.start.to_utc_ns(), run.sample_rate_hz)
    precise = precise_positions(run)
    rtk = [replace(p, method="rtk", status=PreciseStatus.FIX) for p in precise]
    return StationData(
        clock, run.bench.station(), list(run.inputs.imu), list(run.inputs.pvt), precise, rtk
    )


RECEIVER = (commissioning.start_time, commissioning.position, commissioning.phase_centre,
            commissioning.clock)  # fmt: skip
QUICK = (*RECEIVER, commissioning.gravity, commissioning.turning, commissioning.noise)


def found(data, which=(commissioning.shaking,)):
    return {item.name: item for check in which for item in check(data)}


def fails(data, which=QUICK):
    return {name for name, check in found(data, which).items() if check.status == FAIL}


def imu(data, force=None, rate=None, delay=0):
    """Return the data with the IMU's vectors turned by matrices, and late by samples of the IF."""
    A = np.eye(3) if force is None else np.array(force, float)
    B = A if rate is None else np.array(rate, float)
    samples = [
        replace(s, linear_acceleration=A @ s.linear_acceleration,
                angular_velocity=B @ s.angular_velocity, sample_index=s.sample_index + delay)
        for s in data.imu
    ]  # fmt: skip
    return replace(data, imu=samples)


def station(data, **changes):
    return replace(data, station=replace(data.station, **changes))


def test_a_good_station_passes_every_check_but_those_of_the_signal(good):
    said = {item.name: item for item in all_checks(good)}
    assert {n for n, c in said.items() if c.status != PASS} == {"C/N0"}
    assert verdict(list(said.values())) == "Passed as far as the data tell; 1 check is open."


YAWED = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
WRONG = {
    "turned by 90 deg about up": (YAWED, None, "gyroscopes' axes, by the Earth's rate"),
    "upside down": (np.diag([1, -1, -1]), None, "IMU's axes, by gravity"),
    "forward is up": ([[0, 0, -1], [0, 1, 0], [1, 0, 0]], None, "IMU's axes, by gravity"),
    "left mirrored": (np.diag([1, -1, 1]), np.eye(3), "IMU and GNSS while moving"),
    "gyroscopes mirrored": (np.eye(3), -np.eye(3), "gyroscopes' axes, by the Earth's rate"),
    "in g": (np.eye(3) / 9.80665, np.eye(3), "specific force at rest"),
    "rates in deg/s": (np.eye(3), np.eye(3) * 57.3, "gyroscopes' axes, by the Earth's rate"),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_axes_signs_and_units_of_the_imu_are_caught(good, what):
    force, rate, name = WRONG[what]
    which = (commissioning.shaking,) if "moving" in name else QUICK
    assert name in fails(imu(good, force, rate), which)


def test_what_the_axes_are_is_said(good):
    check = found(imu(good, YAWED))["IMU and GNSS while moving"]
    assert check.status == FAIL
    assert check.text == "by the data forward is left, left is -forward"


def test_a_wrong_lever_arm_is_caught_and_the_right_one_said(good):
    true = np.asarray(good.station.imu_to_antenna)
    check = found(station(good, imu_to_antenna=true + np.array([0.0, 0.10, 0.0])))[
        "lever arm, IMU to antenna"
    ]
    assert check.status == FAIL
    said = np.array(check.found.split(" m,")[0].split(), float)
    np.testing.assert_allclose(said, true, atol=0.02)


def test_a_late_imu_is_caught(good):
    late = round(0.012 * good.clock.sample_rate_hz)
    check = found(imu(good, delay=late))["IMU's time offset"]
    assert check.status == FAIL
    assert float(check.found.split()[0]) == pytest.approx(-12.0, abs=1.0)


def test_a_monument_of_another_place_is_caught(good):
    moved = good.station.monument_ecef + np.array([0.0, 0.0, 25.0])
    assert "monument, by mean position" in fails(station(good, monument_ecef=moved))


def test_epochs_without_a_position_hide_no_wrong_monument(good):
    """Satellites were few for a moment: not a number is no agreement."""
    pvt = list(good.pvt)
    for k in (50, -1):
        nothing = {"status": PvtStatus.NONE, "position_ecef": np.full(3, np.nan)}
        pvt[k] = replace(pvt[k], satellites=(), **nothing)
    patchy = replace(good, pvt=pvt)
    assert not fails(patchy, RECEIVER)
    moved = good.station.monument_ecef + np.array([0.0, 0.0, 25.0])
    wrong = station(patchy, monument_ecef=moved)
    assert fails(wrong, RECEIVER) == {"monument, by mean position"}


def test_a_phase_centre_off_by_5_cm_is_caught(good):
    off = np.array([0.0, 0.0, 0.05])
    rtk = [replace(p, displacement_enu=p.displacement_enu + off) for p in good.rtk]
    assert fails(replace(good, rtk=rtk)) == {"antenna's phase centre, against a base"}


def test_a_poor_clock_is_caught(good):
    drifts = [replace(p, clock_drift=p.clock_drift + 3e3) for p in good.pvt]
    assert fails(replace(good, pvt=drifts)) == {"clock source, frequency"}
    random = np.random.default_rng(1)
    noisy = [replace(p, clock_drift=p.clock_drift + random.normal(0, 30.0)) for p in good.pvt]
    assert fails(replace(good, pvt=noisy)) == {"clock source, Allan deviation at 1 s"}


def test_an_imu_of_a_poorer_grade_and_a_dead_one_are_caught(good):
    random = np.random.default_rng(2)
    noisy = [
        replace(s, linear_acceleration=s.linear_acceleration + random.normal(0, 0.05, 3))
        for s in good.imu
    ]
    assert any("noise of the accelerometers" in n for n in fails(replace(good, imu=noisy)))
    dead = [
        replace(s, angular_velocity=np.round(s.angular_velocity, 2) + good.imu[0].angular_velocity)
        for s in good.imu
    ]
    assert any("noise of the gyroscopes" in n for n in fails(replace(good, imu=dead)))


def test_a_start_that_is_seconds_off_is_caught(good):
    clock = SampleClock(good.clock.start_utc_ns + 3 * 10**9, good.clock.sample_rate_hz)
    assert "start of the recording" in fails(replace(good, clock=clock))


def test_a_station_that_only_stands_leaves_shaking_open(good):
    end = 13.0 * good.clock.sample_rate_hz
    still = replace(
        good,
        imu=[s for s in good.imu if s.sample_index < end],
        pvt=[p for p in good.pvt if p.sample_index < end],
        precise=[],
        rtk=[],
    )
    assert found(still)["IMU and GNSS while moving"].status == OPEN
    assert not fails(still)


def test_a_tilt_of_one_degree_is_caught(good):
    C = matrix_from_rotvec(np.radians([1.0, 0.0, 0.0]))
    assert "IMU's axes, by gravity" in fails(imu(good, C))


@pytest.mark.parametrize("tau", [0.1, 1.0, 5.0])
def test_the_allan_deviation_is_that_of_allantools(tau):
    values = np.cumsum(np.random.default_rng(4).standard_normal(5000))
    _, expected, *_ = allantools.oadev(values, rate=100.0, data_type="freq", taus=[tau])
    assert allan(values, 0.01, tau) == pytest.approx(expected[0], rel=1e-9)


def test_the_page_puts_failures_first_and_escapes_what_it_shows(good):
    bad = station(good, name="<b>", imu_to_antenna=np.array([9.0, 9.0, 9.0]))
    text = page(
        "<b>",
        [
            *found(bad, QUICK).values(),
            Check("a", FAIL, "<i>", ""),
            *commissioning.signal(bad),
        ],
    )
    assert "<b>" not in text.split("<main>")[0].split("<body>")[1]
    body = text.split("<tbody>")[1]
    assert body.index(">fail<") < body.index(">open<") < body.index(">pass<")


def test_a_gap_of_the_imu_shifts_no_second_that_is_called_still(good):
    """It rests to 14 s and from 35 s on; 5.4 s of the rest are missing, not at whole seconds."""
    rate = good.clock.sample_rate_hz
    kept = [s for s in good.imu if not 3.3 < s.sample_index / rate < 8.7]
    gap = replace(good, imu=kept)
    middles = np.arange(36) + 0.5

    def still(data):
        return [data.is_still_at(round(t * rate)) for t in middles]

    expected = np.array(still(good)) & ~((middles > 4.0) & (middles < 8.0))
    lacking = np.flatnonzero(expected != still(gap))
    assert set(lacking) <= {3, 8}  # seconds of which a part is missing
    assert not fails(gap)
    assert found(gap)["IMU and GNSS while moving"].status == PASS


def test_an_imu_that_speaks_in_bursts_leaves_its_checks_open(good):
    rate = good.clock.sample_rate_hz
    bursts = replace(good, imu=[s for s in good.imu if s.sample_index / rate % 1.0 < 0.2])
    checks = found(bursts, (commissioning.gravity, commissioning.turning, commissioning.shaking))
    assert {check.status for check in checks.values()} == {OPEN}
    assert not bursts.is_still_at(round(5 * rate))
