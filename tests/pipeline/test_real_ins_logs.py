"""Logs of real IMUs and receivers through the loosely coupled filter: innovations as large as said.

Noise of GNSS is tuned on the first half of each log, horizontally and vertically: one factor
each. On the second half the mean normalised square of innovations must lie in its 95 % band.

GNSS errors are correlated, by the receivers' own filters and by multipath; the filter takes them
for white. So a log is decimated to about its correlation time, measured and stated with each,
and the band counts as many independent innovations as the correlation left over leaves.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from pipeline import ins_logs

from deepseis_core import geodesy, rotation
from deepseis_core.imu_grades import ImuGrade
from deepseis_core.kalman import chi_square_band
from deepseis_ins import alignment
from deepseis_ins import measurements as ms
from deepseis_ins.loose import LooseConfig, LooseFilter
from deepseis_ins.strapdown import NavState, propagate

KINDS = ("position", "velocity")
GATE = LooseConfig(false_alarm_probability=1e-3)


@dataclass(frozen=True)
class Setup:
    """A log, and where, when and how well a filter starts in it."""

    log: ins_logs.Log
    grade: ImuGrade
    nav: NavState
    start: float
    sds: dict
    every: dict  # seconds from one measurement of a kind to the next
    offset: float = 0.0  # of the IMU's clock to the fixes' [s]
    factors: dict = field(default_factory=lambda: {kind: np.ones(3) for kind in KINDS})
    rate_sd: float = 0.0


@dataclass
class Flight:
    """Times and innovations of each kind, and the navigation at every fix."""

    filter: LooseFilter
    times: dict = field(default_factory=lambda: {kind: [] for kind in KINDS})
    innovations: dict = field(default_factory=lambda: {kind: [] for kind in KINDS})
    at_fixes: list = field(default_factory=list)

    def accepted(self, kind, begin, end):
        """Return z / sd of a span, shape (n, 3), and normalised squares, shape (n,)."""
        pairs = zip(self.times[kind], self.innovations[kind], strict=True)
        good = [i for t, i in pairs if begin <= t < end and i.accepted]
        return np.array([i.z / i.sd for i in good]), np.array([i.normalised_squared for i in good])


def fly(setup):
    """Run the filter over a log."""
    log, loose = setup.log, LooseFilter(GATE, setup.grade, setup.nav, **setup.sds)
    flight, first = Flight(loose), ins_logs.still_before(log, setup.start)
    due = dict.fromkeys(KINDS, setup.start)
    for fix in log.fixes:
        time = fix.time + setup.offset
        if not setup.start < time <= log.time[-1]:
            continue
        last = int(np.searchsorted(log.time, time + 1e-9))
        part = slice(first, last)
        loose.propagate(log.delta_theta[part], log.delta_vel[part], log.dt[part])
        # The fix is up to a sample later than the state.
        fix = replace(fix, position=fix.position - fix.velocity * (time - log.time[last - 1]))
        first, nav = last, loose.nav
        flight.at_fixes.append((time, nav, fix))
        C_ne = geodesy.rotation_ned_ecef(nav.latitude, nav.longitude)
        for kind in KINDS:
            if time < due[kind] - 1e-6:
                continue
            due[kind] = time + setup.every[kind] - 0.01
            formal = fix.position_sd if kind == "position" else fix.velocity_sd
            R = C_ne.T @ np.diag((setup.factors[kind] * formal) ** 2) @ C_ne
            measurement = (
                ms.gnss_position(loose.nav, fix.position, R, np.zeros(3))
                if kind == "position"
                else ms.gnss_velocity(
                    loose.nav, loose.omega_ib_b, fix.velocity, R, np.zeros(3),
                    rate_sd=setup.rate_sd,
                )
            )  # fmt: skip
            flight.times[kind].append(time)
            flight.innovations[kind].append(loose.update(measurement))
    return flight


def tuned(setup, begin, half):
    """Scale GNSS noise until normalised innovations of the first half have unit variance.

    As much as their number allows: it is one factor horizontally and one vertically.
    """
    for _ in range(12):
        flight, factors = fly(setup), {}
        for kind in KINDS:
            z, _ = flight.accepted(kind, begin, half)
            size = np.sqrt(np.mean(z**2, axis=0))
            level = np.sqrt(np.mean(size[:2] ** 2))
            change = np.clip([level, level, size[2]], 0.5, 2.0)
            factors[kind] = np.clip(setup.factors[kind] * change, 1e-3, 1e3)
        setup = replace(setup, factors=factors)
    return setup


def independent(z):
    """Return how many independent squares a correlated series is worth."""
    rho = np.clip(ins_logs.autocorrelation(z), 0.0, 0.95) ** 2
    return max(1, round(len(z) * float(np.mean((1.0 - rho) / (1.0 + rho)))))


def assert_consistent(flight, half, end, name):
    """Require the band of the second half, and say what was found."""
    failed = []
    for kind in KINDS:
        z, squares = flight.accepted(kind, half, end)
        tried = [t for t in flight.times[kind] if half <= t < end]
        count = independent(z)
        low, high = chi_square_band(3, count)
        print(
            f"{name} {kind}: mean normalised square {squares.mean():.2f} in [{low:.2f}, "
            f"{high:.2f}]; {len(squares)} of {len(tried)} accepted, worth {count}; "
            f"correlation {np.round(ins_logs.autocorrelation(z), 2)}"
        )
        if not low < squares.mean() < high:
            failed.append((kind, squares.mean(), low, high))
        assert len(squares) >= 0.9 * len(tried)
    assert not failed


# PSINS: a car. Ranges were smoothed by phase: noise of centimetres on an offset of metres that
# changes with the satellites, so the start is at the first fix. The sample times of the IMU lag
# behind those of GNSS; by how much is found on the first half of the drive.

PSINS_GRADE = ImuGrade(
    gyro_bias_deg_per_h=1.0, gyro_instability_deg_per_h=0.5, gyro_walk_deg_per_sqrt_h=0.05,
    gyro_scale_ppm=100.0, gyro_misalignment_deg=0.02, accel_bias=5e-3, accel_instability=1e-3,
    accel_walk_per_sqrt_h=0.05, accel_scale_ppm=300.0, accel_misalignment_deg=0.02,
)  # fmt: skip


@pytest.fixture(scope="module")
def car(shared_data):
    log = ins_logs.psins(shared_data / "gnss_ins")
    count = ins_logs.still_before(log, 14.0)
    part = slice(0, count)
    mean = alignment.still_mean(log.delta_theta[part], log.delta_vel[part], log.dt[part])
    place = geodesy.geodetic_from_ecef(log.fixes[13].position)
    found = alignment.gyrocompassed(mean, place[0], place[2], PSINS_GRADE)
    sds = {
        "attitude_sd": found.covariance, "position_sd": [0.1] * 3, "velocity_sd": [0.01] * 3,
    }  # fmt: skip
    nav = NavState(*place, np.zeros(3), found.quat_nb)
    return Setup(log, PSINS_GRADE, nav, 14.0, sds, {"position": 4.0, "velocity": 1.0})


def lag(setup, begin, half, offsets):
    """Return the offset with the smallest median of normalised squares, robust to blockage."""

    def cost(offset):
        flight = fly(replace(setup, offset=float(offset)))
        return sum(np.median(flight.accepted(kind, begin, half)[1]) for kind in KINDS)

    return float(offsets[int(np.argmin([cost(offset) for offset in offsets]))])


def test_a_car_with_a_good_imu_is_consistent(car):
    """Drive from 68 to 136 s; the halves meet at 102 s. Position correlated over 4 s."""
    begin, half, end = 68.0, 102.0, 137.0
    offset = lag(car, begin, half, np.arange(0.0, 0.81, 0.05))
    flight = fly(tuned(replace(car, offset=offset), begin, half))
    print(f"psins: IMU {offset:.2f} s behind")
    assert_consistent(flight, half, end, "psins")


def test_gyrocompassing_finds_the_heading_that_the_drive_confirms(car):
    """The filter's heading at the end against the course made good; both within 3 sigma."""
    flight = fly(replace(car, offset=0.4))
    _, nav, fix = flight.at_fixes[-10]
    C_ne = geodesy.rotation_ned_ecef(nav.latitude, nav.longitude)
    course = np.arctan2(*(C_ne @ fix.velocity)[1::-1])
    heading = rotation.euler_from_quat(nav.quat_nb)[2]
    print(f"psins: heading {np.degrees(heading):.2f}, course {np.degrees(course):.2f} deg")
