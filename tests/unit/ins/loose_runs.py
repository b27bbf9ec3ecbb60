"""Runs of the loosely coupled filter on simulated units, and their true errors."""

from dataclasses import dataclass, field

import numpy as np

from deepseis_core import geodesy, rotation
from deepseis_core.imu_errors import ImuErrors
from deepseis_core.imu_grades import grade_named
from deepseis_ins import alignment
from deepseis_ins import measurements as ms
from deepseis_ins.loose import LooseConfig, LooseFilter
from deepseis_ins.strapdown import NavState
from deepseis_sim.imu import ImuSynthesizer
from deepseis_sim.site import Site

SITE = Site([0.62, 2.44, 50.0])
LAT, LON, HEIGHT = SITE.origin_geodetic
RATE = 200
LEVER = np.array([0.1, -0.2, -0.5])
C_TRUE = rotation.ned_frd_from_enu_flu(np.eye(3))  # level, heading east, as motions have it
C_NE = geodesy.rotation_ned_ecef(LAT, LON)
POSITION_SD, VELOCITY_SD = np.array([0.5, 0.5, 1.0]), np.array([0.02, 0.02, 0.04])
ATTITUDE_SD = np.radians(0.03)
STILL_VELOCITY_SD, STILL_ANGLE_SD = 1e-3, 1e-4
ALIGNING = 10.0  # [s] that estimate the turn-on bias of MEMS before the filter starts


@dataclass
class Run:
    """A filter, what it was told, and how it erred.

    ``errors`` and ``covariances`` are of every second, ``innovations`` of all measurements;
    ``steps`` are what a smoother wants, with the true error after each in ``step_errors``.
    """

    filter: LooseFilter
    times: list = field(default_factory=list)
    errors: list = field(default_factory=list)
    covariances: list = field(default_factory=list)
    innovations: list = field(default_factory=list)
    steps: list = field(default_factory=list)
    step_errors: list = field(default_factory=list)

    def squares(self, name):
        return [i.normalised_squared for i in self.innovations if i.name == name]

    def at(self, time):
        """Return error and covariance at a time."""
        i = int(np.argmin(np.abs(np.array(self.times) - time)))
        return self.errors[i], self.covariances[i]


class Unit:
    """A simulated IMU of a grade on a motion, and the grade that its filter is told."""

    def __init__(self, grade, motion, seconds, seed, ideal, *, told=None):
        true = grade_named(grade) if isinstance(grade, str) else grade
        self.grade, self.motion = true if told is None else told, motion
        unit = ImuErrors(true, float(RATE), seed)
        count = RATE * seconds
        got = unit.apply(0, ideal.delta_theta[:count], ideal.delta_vel[:count])
        self.theta, self.vel = (rotation.flu_from_frd(x) for x in (got.delta_theta, got.delta_vel))
        self.truth = unit.truth(0, count)

    def error(self, filter_, time):
        """Return the true error of a filter, shape (15,)."""
        nav, n = filter_.nav, round(time * RATE) - 1
        place = SITE.ecef(self.motion.at(np.array([time])), np.zeros(3))
        ours = geodesy.ecef_from_geodetic([nav.latitude, nav.longitude, nav.height])
        phi = -rotation.rotvec_from_matrix(rotation.matrix_from_quat(nav.quat_nb) @ C_TRUE.T)
        gravity = self.truth.accel_matrix @ [0.0, 0.0, geodesy.normal_gravity(LAT, HEIGHT)]
        gyro, accel = self.truth.gyro_bias[n], self.truth.accel_bias[n] + gravity
        return np.hstack(
            [
                C_NE @ (ours - place.position[0]),
                nav.vel_n - C_NE @ place.velocity[0],
                phi,
                rotation.flu_from_frd(gyro) - filter_.gyro_bias,
                rotation.flu_from_frd(accel) - filter_.accel_bias,
            ]
        )


def started(unit, rng, *, smoothing=False, make=LooseFilter):
    """Return a filter in error as it is told, and when it starts; MEMS aligns first."""
    phi, r = ATTITUDE_SD * rng.standard_normal(3), POSITION_SD * rng.standard_normal(3)
    place = geodesy.geodetic_from_ecef(SITE.origin_ecef + C_NE.T @ r)
    quat = rotation.quat_from_matrix(rotation.matrix_from_rotvec(-phi) @ C_TRUE)
    biases, start = {}, 0.0
    if unit.grade.gyros.bias > np.radians(0.1):
        n, start = round(ALIGNING * RATE), ALIGNING
        mean = alignment.still_mean(unit.theta[:n], unit.vel[:n], 1.0 / RATE)
        attitude = alignment.Alignment(quat, ATTITUDE_SD**2 * np.eye(3))
        bias = alignment.gyro_bias(mean, attitude, LAT, unit.grade)
        biases = {"gyro_bias": bias.value, "gyro_bias_sd": bias.sd}
    loose = make(
        LooseConfig(),
        unit.grade,
        NavState(*place, np.zeros(3), quat),
        attitude_sd=[ATTITUDE_SD] * 3,
        position_sd=POSITION_SD,
        velocity_sd=[1e-6] * 3,
        smoothing=smoothing,
        **biases,
    )
    return loose, start


def gnss(unit, loose, time, rng):
    """Return position and velocity of the antenna, noisy."""
    at = SITE.ecef(unit.motion.at(np.array([time])), rotation.flu_from_frd(LEVER))
    position = at.position[0] + C_NE.T @ (POSITION_SD * rng.standard_normal(3))
    velocity = at.velocity[0] + C_NE.T @ (VELOCITY_SD * rng.standard_normal(3))
    P_position, P_velocity = (C_NE.T @ np.diag(sd**2) @ C_NE for sd in (POSITION_SD, VELOCITY_SD))
    rate_sd = unit.grade.gyros.walk * np.sqrt(RATE)
    yield lambda: ms.gnss_position(loose.nav, position, P_position, LEVER)
    yield lambda: ms.gnss_velocity(
        loose.nav, loose.omega_ib_b, velocity, P_velocity, LEVER, rate_sd=rate_sd
    )


def constraints(loose, C_reference, rng, *, velocity=True, angle=True):
    """Return zero velocity and zero angle, noisy as they say."""
    shift = STILL_VELOCITY_SD * rng.standard_normal(3), STILL_ANGLE_SD * rng.standard_normal(3)

    def shaken(m, by):
        return ms.Measurement(m.z + by, m.H, m.R, m.name, m.states, m.D)

    if velocity:
        yield lambda: shaken(ms.zero_velocity(loose.nav, STILL_VELOCITY_SD), shift[0])
    if angle:
        yield lambda: shaken(ms.zero_angle(loose.nav, C_reference, STILL_ANGLE_SD), shift[1])


def ideal_increments(motion, seconds):
    return ImuSynthesizer(motion, SITE, float(RATE)).increments(0, RATE * seconds)


def fly(
    unit, seconds, measurements, *, seed, rate_hz=1, every=1, smoothing=False, make=LooseFilter
):
    """Run a filter; ``measurements(loose, time, C_reference, rng)`` says what it is told when."""
    rng = np.random.default_rng([seed, 7])
    loose, start = started(unit, rng, smoothing=smoothing, make=make)
    run, C_ref = Run(loose), rotation.matrix_from_quat(loose.nav.quat_nb)
    step = RATE // rate_hz
    for first in range(round(start * RATE), seconds * RATE, step):
        loose.propagate(unit.theta[first : first + step], unit.vel[first : first + step], 1 / RATE)
        time = (first + step) / RATE
        for measurement in measurements(loose, time, C_ref, rng):
            run.innovations.append(loose.update(measurement()))
        if smoothing:
            run.steps += loose.take_steps()
            run.step_errors.append(unit.error(loose, time))
        if (first + step) % (every * RATE) == 0:
            run.times.append(time)
            run.errors.append(unit.error(loose, time))
            run.covariances.append(loose.P)
    return run
