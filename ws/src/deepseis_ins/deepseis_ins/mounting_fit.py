"""Least squares of an IMU's time offset and lever arm, over stretches of some seconds.

Within a stretch the specific force is turned by the gyroscopes' attitude and integrated. With
the errors psi0 of the first attitude, b and d of gyroscopes and accelerometers, s of scale ::

    psi(t) = psi0 - int C b,   dv(t) = dv0 + int (psi x f + C (diag(f_b) s - d)),   dp = dp0 + int dv
    antenna: p + C l,  v + C (w x l);  at the time of GNSS less the offset

All is linear in the unknowns but the products of small ones; a few iterations settle them. What
the IMU's own noise does to the integrals, and the creeping of positions, is in the covariance by
which the residuals are weighted. Unknowns of one stretch are eliminated before the common ones
are solved for (J. Kusche, B. Gundlich: normal equations with nuisance parameters).
"""  # noqa: E501

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import cholesky, solve_triangular

from deepseis_core.errors import InputError
from deepseis_core.geodesy import normal_gravity
from deepseis_core.rotation import matrix_from_quat, quat_from_rotvec, quat_multiply
from deepseis_core.types import FloatArray
from deepseis_ins.alignment import earth_rate
from deepseis_ins.mounting_data import AntennaSeries, ImuSeries, MountingConfig
from deepseis_ins.mounting_kernels import attitude_kernel

COMMON = 7
"""Offset, lever arm, scale factors of the accelerometers."""
PSI, GYRO, ACCEL, VEL, POS = (slice(k, k + 3) for k in (0, 3, 6, 9, 12))
ITERATIONS = 8
LEAST_EPOCHS = 8
OUTLIER = 4.0


@dataclass(frozen=True)
class Fitted:
    """Offset [s], lever arm forward-right-down [m], their covariance (4, 4), and how it fits."""

    offset: float
    lever_arm: FloatArray
    covariance: FloatArray
    first_quat_nb: FloatArray
    residual_ratio: float
    stretches: int


@dataclass
class _Stretch:
    """Some seconds, and their own unknowns so far."""

    imu: ImuSeries
    epochs: Any
    quat: FloatArray
    gyro_bias: FloatArray
    own: FloatArray = field(default_factory=lambda: np.zeros(15))
    turned: FloatArray = field(default_factory=lambda: np.zeros(3))
    weight: float = 0.0
    """How much it has to say of the heading."""
    roots: list[FloatArray] = field(default_factory=list)
    """Of the covariance of its epochs, one an axis."""


def fit_mounting(
    imu: ImuSeries,
    antenna: AntennaSeries,
    quat_nb: FloatArray,
    gyro_bias: FloatArray,
    offset: float,
    lever_arm: FloatArray,
    config: MountingConfig,
) -> Fitted:
    """Fit offset and lever arm; see `deepseis_ins.mounting.estimate_mounting`.

    Raises
    ------
    InputError
        No stretch has enough of both.
    """
    stretches = _cut(imu, antenna, quat_nb, gyro_bias, offset, config)
    if not stretches:
        raise InputError("mounting", "no stretch has both IMU and GNSS", "is there a gap?")
    turns = _turning(stretches, quat_nb, imu) > config.least_turning
    problem = _Problem(antenna, lever_arm, offset, config, turns)
    common = np.concatenate([[offset], lever_arm, np.zeros(3)])
    for _ in range(ITERATIONS):
        step, covariance = problem.solve(stretches, common)
        common = common + step
        if abs(step[0]) < 1e-7 and np.max(np.abs(step[1:4])) < 1e-5:
            break
    ratio, widened = problem.left_over(stretches, common)
    covariance = covariance * widened
    if not turns:
        covariance[1:4, :] = covariance[:, 1:4] = 0.0
        covariance[1:4, 1:4] = np.eye(3) * config.lever_arm_sd**2
    weights = np.array([max(stretch.weight, 1e-9) for stretch in stretches])
    turned = np.average([stretch.turned for stretch in stretches], axis=0, weights=weights)
    first = quat_multiply(quat_from_rotvec(turned), quat_nb[0])
    return Fitted(float(common[0]), common[1:4], covariance[:4, :4], first, ratio, len(stretches))


def _turning(stretches: list[_Stretch], quat_nb: FloatArray, imu: ImuSeries) -> float:
    """Return by how much it turns to and fro, r.m.s. over the stretches [rad].

    Of what is left of the turn since the middle of a stretch after a straight line: a constant
    bias is none.
    """
    square, count = 0.0, 0
    for stretch in stretches:
        begin = int(np.searchsorted(imu.time, stretch.imu.time[0]))
        C = matrix_from_quat(quat_nb[begin : begin + len(stretch.imu.time)])
        D = np.swapaxes(C[len(C) // 2][None], 1, 2) @ C
        turn = 0.5 * np.stack([D[:, 2, 1] - D[:, 1, 2], D[:, 0, 2] - D[:, 2, 0],
                               D[:, 1, 0] - D[:, 0, 1]], axis=1)  # fmt: skip
        line = np.stack([np.ones(len(C)), stretch.imu.time], axis=1)
        left = turn - line @ np.linalg.lstsq(line, turn, rcond=None)[0]
        square, count = square + float(np.sum(left**2)), count + len(C)
    return float(np.sqrt(square / max(1, count)))


def _cut(
    imu: ImuSeries,
    antenna: AntennaSeries,
    quat_nb: FloatArray,
    gyro_bias: FloatArray,
    offset: float,
    config: MountingConfig,
) -> list[_Stretch]:
    """Cut into stretches without gaps and keep those that move most."""
    found: list[tuple[float, int, _Stretch]] = []
    length = max(config.stretch, 2.0 * LEAST_EPOCHS / antenna.rate_hz)
    begin = 0
    gap = np.diff(imu.time) > 1.5 * imu.dt[1:] + 1e-6
    ends = np.flatnonzero(gap) + 1
    while begin < len(imu.time) - 2:
        end = int(np.searchsorted(imu.time, imu.time[begin] + length))
        broken = ends[(ends > begin) & (ends < end)]
        end = int(broken[0]) if len(broken) else min(end, len(imu.time))
        part = imu.part(begin, end) if end - begin > 2 else None
        if part is not None:
            # half a second at both ends lets the offset move without losing epochs
            margin = min(0.5, 0.1 * (part.time[-1] - part.time[0]))
            inside = (antenna.time > part.time[0] + offset + margin) & (
                antenna.time < part.time[-1] + offset - margin
            )
            epochs = np.flatnonzero(inside)
            if len(epochs) >= LEAST_EPOCHS:
                force = part.delta_vel_b / part.dt[:, None]
                stretch = _Stretch(part, epochs, quat_nb[begin], gyro_bias.copy())
                found.append((float(np.var(force, axis=0).sum()), begin, stretch))
        begin = max(end, begin + 1)
    best = sorted(found, key=lambda item: -item[0])[: config.most_stretches]
    return [item[2] for item in sorted(best, key=lambda item: item[1])]


class _Problem:
    """The normal equations."""

    def __init__(
        self,
        antenna: AntennaSeries,
        lever_arm: FloatArray,
        offset: float,
        config: MountingConfig,
        turns: bool,
    ) -> None:
        self.antenna, self.config = antenna, config
        self.prior = np.concatenate([[offset], lever_arm, np.zeros(3)])
        self.prior_sd = np.array(
            [config.offset_sd, *[config.lever_arm_sd] * 3, *[config.accel_scale_sd] * 3]
        )
        if not turns:  # noise of the gyroscopes must not pass for turning
            self.prior_sd[1:4] = 1e-6
        free = [1e3] * 6  # first velocity and position are not known at all
        spread = (config.attitude_sd, config.gyro_bias_sd, config.accel_bias_sd)
        self.own_sd = np.array([*np.repeat(spread, 3), *free])
        g = float(normal_gravity(antenna.latitude, antenna.height))
        self.gravity_n, self.earth_n = np.array([0.0, 0.0, g]), earth_rate(antenna.latitude)

    def solve(
        self, stretches: list[_Stretch], common: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Correct the stretches; return the step of the common unknowns, and their covariance."""
        weight = 1.0 / np.maximum(self.prior_sd, 1e-12) ** 2
        N, right = np.diag(weight), weight * (self.prior - common)
        parts = []
        for stretch in stretches:
            A, B, y = self._equations(stretch, common)
            own = 1.0 / np.maximum(self.own_sd, 1e-12) ** 2
            N_own = B.T @ B + np.diag(own)
            stretch.weight = 1.0 / float(np.linalg.inv(N_own)[2, 2]) - own[2]
            back = np.linalg.solve(N_own, np.column_stack([B.T @ A, B.T @ y - own * stretch.own]))
            N += A.T @ A - A.T @ B @ back[:, :COMMON]
            right += A.T @ y - A.T @ B @ back[:, COMMON]
            parts.append((stretch, back))
        step = np.linalg.solve(N, right)
        for stretch, back in parts:
            self._correct(stretch, back[:, COMMON] - back[:, :COMMON] @ step)
        return step, np.linalg.inv(N)

    def left_over(self, stretches: list[_Stretch], common: FloatArray) -> tuple[float, float]:
        """Return the r.m.s. of weighted residuals, and by how much variances are to be widened.

        Residuals that follow each other have less to say than as many that do not.
        """
        square, count, lag = 0.0, 0, 0.0
        for stretch in stretches:
            left = self._equations(stretch, common)[2].reshape(3, -1)
            square, count = square + float(np.sum(left**2)), count + left.size - 15
            lag += float(np.sum(left[:, 1:] * left[:, :-1]))
        ratio = square / max(1, count)
        correlated = min(max(lag / max(square, 1e-30), 0.0), 0.95)
        widened = max(1.0, ratio * (1.0 + correlated) / (1.0 - correlated))
        return float(np.sqrt(ratio)), widened

    def _correct(self, stretch: _Stretch, own: FloatArray) -> None:
        stretch.quat = quat_multiply(quat_from_rotvec(own[PSI]), stretch.quat)
        stretch.turned = stretch.turned + own[PSI]
        stretch.gyro_bias = stretch.gyro_bias + own[GYRO]
        stretch.own = stretch.own + own

    def _equations(
        self, stretch: _Stretch, common: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the weighted partials by common and own unknowns, and what is left."""
        imu, own = stretch.imu, stretch.own
        path = _Path(self, stretch, common[4:7])
        offset, lever = common[0], common[1:4]
        time = np.concatenate([[imu.time[0] - imu.dt[0]], imu.time])
        seen = self.antenna
        at = seen.time[stretch.epochs] - offset
        value, partials = path.velocity(lever) if seen.is_velocity else path.position(lever)
        spline = CubicSpline(time, value)
        lean = np.stack(
            [_linear(time, partials[:, row, :], at) for row in range(3)]
        )  # (3, epochs, unknowns)
        moves = 0.0 if seen.is_velocity else own[VEL]
        lean[:, :, 0] = -(spline(at, 1) + moves).T
        own_free = own[VEL] if seen.is_velocity else own[POS]
        residual = (seen.value[stretch.epochs] - spline(at) - own_free).T
        residual -= 0.0 if seen.is_velocity else np.outer(own[VEL], at - time[0])
        stretch.roots = stretch.roots or [self._root(k, at - time[0]) for k in range(3)]
        whitened = [
            self._whiten(stretch, k, np.column_stack([residual[k], lean[k]])) for k in range(3)
        ]
        joined = np.concatenate(whitened)
        return joined[:, 1 : 1 + COMMON], joined[:, 1 + COMMON :], joined[:, 0]

    def _whiten(self, stretch: _Stretch, axis: int, columns: FloatArray) -> FloatArray:
        """Weight by the epochs' covariance; what is far off counts less."""
        root = stretch.roots[axis]
        out = solve_triangular(root, columns, lower=True, check_finite=False)
        limit = OUTLIER * max(1.0, 1.4826 * float(np.median(np.abs(out[:, 0]))))
        weight = np.minimum(1.0, limit / np.maximum(np.abs(out[:, 0]), 1e-12))
        return np.asarray(out * np.sqrt(weight)[:, None])

    def _root(self, axis: int, t: FloatArray) -> FloatArray:
        """Return the root of the covariance of noise, creeping, and the IMU's random walk."""
        seen, walk = self.antenna, self.config.accel_walk**2
        early, late = np.minimum.outer(t, t), np.maximum.outer(t, t)
        R = np.diag(np.full(len(t), seen.sd[axis] ** 2))
        if seen.is_velocity:
            R += walk * early
        else:
            R += seen.creep**2 * (early - early[0, 0]) + walk * early**2 * (3 * late - early) / 6
        return np.asarray(cholesky(R, lower=True, check_finite=False))


class _Path:
    """A stretch integrated, at the ends of its n intervals and at its beginning, n + 1 rows."""

    def __init__(self, problem: _Problem, stretch: _Stretch, scale: FloatArray) -> None:
        imu = stretch.imu
        dt = imu.dt
        theta = imu.delta_theta_b - stretch.gyro_bias * dt[:, None]
        vel = imu.delta_vel_b * (1.0 + scale) - stretch.own[ACCEL] * dt[:, None]
        quat = np.empty((len(dt) + 1, 4))
        attitude_kernel(stretch.quat, theta, dt, problem.earth_n, quat)
        self.C, self.dt = matrix_from_quat(quat), dt
        middle = vel + 0.5 * np.cross(theta, vel)
        self.delta_n = np.einsum("nij,nj->ni", self.C[:-1], middle)
        first = _sum(self.delta_n + problem.gravity_n * dt[:, None])
        coriolis = -2.0 * np.cross(problem.earth_n, 0.5 * (first[1:] + first[:-1]))
        self.v = _sum(self.delta_n + (problem.gravity_n + coriolis) * dt[:, None])
        self.p = _sum(0.5 * (self.v[1:] + self.v[:-1]) * dt[:, None])
        rate = theta / dt[:, None]
        self.omega = np.vstack([rate[:1], 0.5 * (rate[1:] + rate[:-1]), rate[-1:]])
        self.time = np.concatenate([[0.0], np.cumsum(dt)])
        self._partials(vel)

    def _partials(self, vel: FloatArray) -> None:
        """Fill the partials of attitude, velocity and position by own unknowns and scales."""
        n = len(self.dt)
        one, zero = np.broadcast_to(np.eye(3), (n + 1, 3, 3)), np.zeros((n + 1, 3, 3))
        turn_by_gyro = -_sum(0.5 * (self.C[1:] + self.C[:-1]) * self.dt[:, None, None])
        force = -_skew(self.delta_n)  # psi x f = -f x psi
        by_psi = _sum(force)
        middle = 0.5 * (turn_by_gyro[1:] + turn_by_gyro[:-1])
        by_gyro = _sum(force @ middle)
        by_accel = -_sum(self.C[:-1] * self.dt[:, None, None])
        by_scale = _sum(self.C[:-1] * vel[:, None, :])
        self.turn = np.concatenate([one, turn_by_gyro, zero, zero, zero, zero], axis=2)
        self.by_v = np.concatenate([by_psi, by_gyro, by_accel, one, zero, by_scale], axis=2)
        step = 0.5 * (self.by_v[1:] + self.by_v[:-1]) * self.dt[:, None, None]
        self.by_p = _sum(step)
        self.by_p[:, :, POS] = np.eye(3)

    def position(self, lever: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the antenna's positions, (n + 1, 3), and partials, (n + 1, 3, unknowns)."""
        arm = self.C @ lever
        partials = self.by_p - _skew(arm) @ self.turn
        return self.p + arm, self._ordered(partials, self.C)

    def velocity(self, lever: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the same of velocities."""
        cross = self.C @ _skew(self.omega)
        arm = cross @ lever
        partials = self.by_v - _skew(arm) @ self.turn
        partials[:, :, GYRO] += self.C @ _skew(lever[None])  # -b x l = l x b
        return self.v + arm, self._ordered(partials, cross)

    def _ordered(self, own: FloatArray, lever: FloatArray) -> FloatArray:
        """Put offset, lever arm, scales before the stretch's own unknowns."""
        nothing = np.zeros((*own.shape[:2], 1))
        return np.concatenate([nothing, lever, own[:, :, 15:], own[:, :, :15]], axis=2)


def _sum(steps: FloatArray) -> FloatArray:
    """Add up, beginning with zero."""
    return np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])


def _skew(v: FloatArray) -> FloatArray:
    """Return matrices of cross products, (m, 3, 3)."""
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return out - np.swapaxes(out, 1, 2)


def _linear(time: FloatArray, columns: FloatArray, at: FloatArray) -> FloatArray:
    """Interpolate columns, shape (n, k), linearly."""
    right = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
    part = ((at - time[right - 1]) / (time[right] - time[right - 1]))[:, None]
    return np.asarray(columns[right - 1] * (1.0 - part) + columns[right] * part)
