"""What a vehicle's survey is worked out from, and what comes out: arrays without ROS."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from deepseis_core.config import setting
from deepseis_core.imu_grades import MGAL, ImuGrade
from deepseis_core.types import FloatArray, MotionKind
from deepseis_ins.ldv import LdvInstallation
from deepseis_ins.loose import Innovation
from deepseis_ins.motion_state import MotionConfig, MotionDetector
from deepseis_ins.strapdown import NavState


@dataclass(frozen=True)
class SurveyConfig:
    """How a drive is worked through."""

    gravity_sd_mgal: float = setting(
        20.0, "disturbance of gravity that the filter reckons with [mGal]", low=0.0, high=500.0
    )
    gravity_time: float = setting(100.0, "its correlation time at speed [s]", low=1.0, high=1e5)
    still_sd: float = setting(0.001, "of zero velocity, a window's [m/s]", low=1e-5, high=1.0)
    guard: float = setting(
        1.0, "before a motion's discovery, taken for motion [s]", low=0.0, high=60.0
    )


@dataclass(frozen=True)
class ImuRecord:
    """Increments of an IMU without gaps, forward-right-down, m of them.

    Attributes
    ----------
    time_end : ndarray, shape (m,)
        End of each interval [s].
    delta_theta_b, delta_vel_b : ndarray, shape (m, 3)
        [rad, m/s]
    dt : float
        [s]
    still : ndarray of bool, shape (m,)
        Where the vehicle stands.
    """

    time_end: FloatArray
    delta_theta_b: FloatArray
    delta_vel_b: FloatArray
    dt: float
    still: NDArray[np.bool_]


@dataclass(frozen=True)
class FixRecord:
    """Fixes of GNSS, m of them; what is not a number is not measured.

    Attributes
    ----------
    time : ndarray, shape (m,)
        [s]
    position_ecef, velocity_ecef : ndarray, shape (m, 3)
        Of the antenna [m, m/s].
    position_covariance_ecef, velocity_covariance_ecef : ndarray, shape (m, 3, 3)
    lever_arm_b : ndarray, shape (3,)
        From the IMU to the antenna [m].
    """

    time: FloatArray
    position_ecef: FloatArray
    velocity_ecef: FloatArray
    position_covariance_ecef: FloatArray
    velocity_covariance_ecef: FloatArray
    lever_arm_b: FloatArray


@dataclass(frozen=True)
class Track:
    """A drive as navigated; rows are windows, n of them.

    Attributes
    ----------
    time : ndarray, shape (n,)
        End of the window [s].
    geodetic, vel_n, quat_nb : ndarray, shapes (n, 3), (n, 3), (n, 4)
        After the window's updates [rad, rad, m; m/s].
    sd : ndarray, shape (n, 15)
        Standard deviations of the filter, at every `SD_STEP`-th window; else not a number.
    still : ndarray of bool, shape (n,)
    free_up, aid_up : ndarray, shape (n,)
        Free vertical velocity, and that of the velocimeter (0 at rest), means over the same
        moments [m/s]; not a number where there is none.
    free_rise : ndarray, shape (n,)
        Integral of the free vertical velocity to the window's end [m].
    fix_time, fix_free_up, fix_up : ndarray, shape (m,)
        Fixes with a velocity, while it moves: time [s], free velocity, and GNSS's [m/s].
    innovations : tuple
        Time [s] and `Innovation` of every update but zero velocities.
    residual_b, turn_b : ndarray, shape (k, 3)
        Of every window of the velocimeter: predicted less measured velocity, and mean angular
        rate, body axes [m/s, rad/s].
    installation : LdvInstallation
        At the end, with what is left unknown.
    nav : NavState
        At the end.
    """

    time: FloatArray
    geodetic: FloatArray
    vel_n: FloatArray
    quat_nb: FloatArray
    sd: FloatArray
    still: NDArray[np.bool_]
    free_up: FloatArray
    aid_up: FloatArray
    free_rise: FloatArray
    fix_time: FloatArray
    fix_free_up: FloatArray
    fix_up: FloatArray
    innovations: tuple[tuple[float, Innovation], ...]
    residual_b: FloatArray
    turn_b: FloatArray
    installation: LdvInstallation
    nav: NavState


def survey_grade(grade: ImuGrade, config: SurveyConfig, *, lasting: bool = False) -> ImuGrade:
    """Return the grade with what gravity adds to its accelerometers.

    The mechanisation knows normal gravity; what the real one has in excess, in all three
    components, is an accelerometer's error to the filter, of sd ``s`` and correlation time ``T``.

    Parameters
    ----------
    lasting : bool
        Whether the turn-on bias is to be remembered for longer than T. One Gauss-Markov state for
        both is right over seconds, and forgets the bias as fast as gravity changes: over hours
        axes that lean with the body, as constant as the bias, are height without limit. What
        gravity makes of the velocity is, for longer than T, what white noise of ``s sqrt(2 T)``
        makes; the state is then the bias alone.
    """
    sd = config.gravity_sd_mgal * MGAL
    if lasting:
        walk = float(np.hypot(grade.accelerometers.walk, sd * np.sqrt(2.0 * config.gravity_time)))
        return replace(grade, accel_walk_per_sqrt_h=60.0 * walk)
    if sd <= grade.accel_instability:
        return grade
    return replace(grade, accel_instability=sd, accel_correlation_time=config.gravity_time)


def still_samples(
    delta_theta_b: FloatArray,
    delta_vel_b: FloatArray,
    dt: float,
    grade: ImuGrade,
    guard: float,
) -> NDArray[np.bool_]:
    """Tell at which samples the vehicle stands.

    By `MotionDetector`; its first seconds, in which it only learns, are those of what it says
    next. The last ``guard`` seconds before a motion was discovered may have been its beginning.
    """
    detector = MotionDetector(MotionConfig(), 1.0 / dt, grade)
    changes = detector.push(0, delta_theta_b / dt, delta_vel_b / dt)
    count, margin = len(delta_vel_b), round(guard / dt)
    still = np.zeros(count, np.bool_)
    for k, change in enumerate(changes):
        if change.state != MotionKind.STATIC:
            continue
        end = changes[k + 1].since - margin if k + 1 < len(changes) else count
        still[0 if k == 0 else change.since : max(end, 0)] = True
    return still
