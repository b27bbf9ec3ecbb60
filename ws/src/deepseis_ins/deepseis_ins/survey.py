"""A vehicle's drive worked through afterwards: IMU with GNSS, with a velocimeter, or with both.

Time is cut into windows; at the end of each come the updates: a fix of GNSS, zero velocity where
the vehicle stands, the velocimeter's mean. The installation's scale, pitch and yaw are estimated
along with the 15 states, as well as they are not known before.

Beside the navigation a *free* vertical velocity is kept: that of the mechanisation without any
correction of its velocity, and with the vertical accelerometer's bias left in (the filter cannot
tell it from gravity). Its rate of change is all that gravimetry needs of the IMU
(`deepseis_ins.gravimetry`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np

from deepseis_core.errors import InputError
from deepseis_core.rotation import matrix_from_quat
from deepseis_core.types import FloatArray
from deepseis_ins.ldv import LdvConfig, LdvInstallation, LdvRecord, LdvWindow, ldv_velocity
from deepseis_ins.ldv_kernels import window_kernel
from deepseis_ins.loose import Innovation, LooseFilter
from deepseis_ins.measurements import gnss_position, gnss_velocity, zero_velocity
from deepseis_ins.strapdown import NavState, Trajectory
from deepseis_ins.survey_records import FixRecord, ImuRecord, SurveyConfig, Track

Span = tuple[float, float]
ALWAYS: Final[tuple[Span, ...]] = ((-np.inf, np.inf),)
SD_STEP: Final = 25
"""Windows from one set of standard deviations to the next."""
_WIDTHS: Final = {"geodetic": 3, "vel_n": 3, "quat_nb": 4, "sd": 15}
_COLUMNS: Final = ("still", "free_up", "aid_up", "free_rise")


@dataclass(frozen=True)
class Aids:
    """When each source helps: spans of time [s]."""

    fixes: tuple[Span, ...] = ALWAYS
    ldv: tuple[Span, ...] = ALWAYS


class _Window(NamedTuple):
    """A piece of the drive: rows of the IMU, its end [s], length [s], and the state before."""

    rows: slice
    end: float
    length: float
    before: NavState
    passed: Trajectory


@dataclass
class _Drive:
    """The loop's working values: what free velocity and its height are, among others."""

    loose: LooseFilter
    installation: LdvInstallation
    corrected: float = 0.0  # down velocity that updates, and the bias, added to the free one
    rise: float = 0.0
    innovations: list[tuple[float, Innovation]] = field(default_factory=list)
    fixes: list[tuple[float, float, float]] = field(default_factory=list)
    residuals: list[FloatArray] = field(default_factory=list)


class Survey:
    """Works a drive through.

    Parameters
    ----------
    imu : ImuRecord
    ldv : LdvRecord or None
    fixes : FixRecord or None
    config : SurveyConfig, optional
    ldv_config : LdvConfig, optional
    no_slip_arm_b : tuple of float, optional
        From the IMU to the point that does not slip sideways, the rear axle [m].

    Raises
    ------
    InputError
        There is hardly any data.
    """

    def __init__(
        self,
        imu: ImuRecord,
        ldv: LdvRecord | None,
        fixes: FixRecord | None,
        config: SurveyConfig | None = None,
        ldv_config: LdvConfig | None = None,
        no_slip_arm_b: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        self.imu, self.ldv, self.fixes = imu, ldv, fixes
        self.config, self.ldv_config = config or SurveyConfig(), ldv_config or LdvConfig()
        self.no_slip_arm_b = np.array(no_slip_arm_b)
        step = max(round(self.ldv_config.window / imu.dt), 1)
        self._rows = np.arange(0, imu.time_end.size + 1, step)
        if self._rows.size < 3:
            raise InputError("survey", "its IMU data are shorter than two windows")

    def run(
        self,
        loose: LooseFilter,
        installation: LdvInstallation,
        aids: Aids | None = None,
        *,
        until: float = np.inf,
    ) -> Track:
        """Navigate from the state of a filter at the start of the first interval.

        Parameters
        ----------
        loose : LooseFilter
            Its grade is that of `survey_grade`. It is carried to the end.
        installation : LdvInstallation
            Where its ``sd`` is 0 it is taken as exact.
        aids : Aids, optional
        until : float, optional
            Where to stop [s].
        """
        drive, use = _Drive(loose, installation), aids or Aids()
        loose.refer_constants(installation.sd)
        ends = self.imu.time_end[self._rows[1:] - 1]
        n = max(int(np.searchsorted(ends, until)), 1)
        out: dict[str, FloatArray] = {}
        for name, width in _WIDTHS.items():
            out[name] = np.full((n, width), np.nan)
        for name in _COLUMNS:
            out[name] = np.full(n, np.nan)
        for k in range(n):
            self._step(drive, use, out, k)
        return self._finish(drive, out)

    def _step(self, drive: _Drive, aids: Aids, out: dict[str, FloatArray], k: int) -> None:
        """Carry the filter over window ``k`` and work in what was measured."""
        loose, imu = drive.loose, self.imu
        rows = slice(int(self._rows[k]), int(self._rows[k + 1]))
        before, bias_z = loose.nav, float(loose.accel_bias[2])
        passed = loose.propagate(imu.delta_theta_b[rows], imu.delta_vel_b[rows], imu.dt)
        end, length = float(imu.time_end[rows.stop - 1]), imu.dt * (rows.stop - rows.start)
        window = _Window(rows, end, length, before, passed)
        C_nb = matrix_from_quat(loose.nav.quat_nb)
        taken = float(C_nb[2, 2]) * bias_z * length
        offset = drive.corrected - 0.5 * taken  # at the window's middle, as means are
        still = bool(imu.still[rows].all())
        found = None if still or not _within(end, aids.ldv) else self._ldv_window(drive, window)
        mean_down = _mean_down(window)
        if still:
            out["free_up"][k], out["aid_up"][k] = offset - mean_down, 0.0
        elif found is not None:
            own, measured = found
            out["free_up"][k] = offset - own[2]
            out["aid_up"][k] = measured.predicted_n[2] - measured.measured_n[2] - own[2]
        drive.rise += (offset - mean_down) * length
        out["free_rise"][k] = drive.rise
        drive.corrected -= taken
        self._updates(drive, aids, window, still, None if found is None else found[1])
        nav = loose.nav
        drive.corrected += float(nav.vel_n[2] - passed.vel_n[-1, 2])
        out["geodetic"][k] = nav.latitude, nav.longitude, nav.height
        out["vel_n"][k], out["quat_nb"][k], out["still"][k] = nav.vel_n, nav.quat_nb, still
        if k % SD_STEP == 0:
            out["sd"][k] = loose.sd

    def _ldv_window(self, drive: _Drive, window: _Window) -> tuple[FloatArray, LdvWindow] | None:
        """Average over a window; None where more than half of it is unusable."""
        ldv, imu, rows = self.ldv, self.imu, window.rows
        if ldv is None:
            return None
        start = window.end - window.length
        first, last = np.searchsorted(ldv.time, [start, window.end], side="right")
        usable = np.flatnonzero(ldv.quality[first:last] >= self.ldv_config.quality) + first
        if usable.size == 0 or 2 * usable.size < last - first:
            return None
        velocity = np.zeros((usable.size, 3))
        velocity[:, [0, 2]] = ldv.velocity[usable]
        omega = imu.delta_theta_b[rows] / imu.dt - drive.loose.gyro_bias
        own, predicted, measured = np.empty((3, 3))
        window_kernel(
            np.append(start, imu.time_end[rows]),
            np.vstack([window.before.vel_n, window.passed.vel_n]),
            np.vstack([window.before.quat_nb, window.passed.quat_nb]),
            np.vstack([omega[:1], omega]),
            window.before.latitude,
            ldv.time[usable],
            drive.installation.velocity_b(velocity),
            np.stack([drive.installation.lever_arm_b, self.no_slip_arm_b]),
            own,
            predicted,
            measured,
        )
        variance = ldv.variance[usable].mean(axis=0) / usable.size
        C_nb = matrix_from_quat(drive.loose.nav.quat_nb)
        residual_b = C_nb.T @ (predicted - measured)
        drive.residuals.append(np.hstack([residual_b, omega.mean(axis=0)]))
        return own, LdvWindow(int(usable.size), predicted, measured, variance)

    def _updates(
        self, drive: _Drive, aids: Aids, window: _Window, still: bool, ldv: LdvWindow | None
    ) -> None:
        if self.fixes is not None:
            half = 0.5 * window.length
            times = [window.end - half, window.end + half]
            for k in range(*np.searchsorted(self.fixes.time, times)):
                if _within(float(self.fixes.time[k]), aids.fixes):
                    self._fix(drive, self.fixes, k, window.end, still)
        if still:
            drive.loose.update(zero_velocity(drive.loose.nav, self.config.still_sd))
        if ldv is not None:
            nav = drive.loose.nav
            found = ldv_velocity(
                ldv, matrix_from_quat(nav.quat_nb), drive.loose.omega_ib_b, nav.latitude,
                drive.installation, self.ldv_config,
            )  # fmt: skip
            drive.innovations.append((window.end, drive.loose.update(found)))
            error, _ = drive.loose.take_constants()
            drive.installation = drive.installation.corrected(error)

    def _fix(self, drive: _Drive, fixes: FixRecord, k: int, end: float, still: bool) -> None:
        """Work a fix in; at rest its velocity says less than zero velocity does."""
        loose, time, velocity = drive.loose, float(fixes.time[k]), fixes.velocity_ecef[k]
        late = end - time
        if np.isfinite(velocity).all() and not still:
            down = float(loose.nav.vel_n[2])
            covariance = fixes.velocity_covariance_ecef[k]
            found = gnss_velocity(
                loose.nav, loose.omega_ib_b, velocity, covariance, fixes.lever_arm_b
            )
            drive.fixes.append((time, drive.corrected - down, float(found.z[2]) - down))
            innovation = loose.update(found)
            drive.innovations.append((end, innovation))
        position = fixes.position_ecef[k] + late * np.nan_to_num(velocity)
        if np.isfinite(position).all():
            covariance = fixes.position_covariance_ecef[k]
            found = gnss_position(loose.nav, position, covariance, fixes.lever_arm_b)
            drive.innovations.append((end, loose.update(found)))

    def _finish(self, drive: _Drive, out: dict[str, FloatArray]) -> Track:
        fixes = np.array(drive.fixes).reshape(-1, 3)
        residuals = np.array(drive.residuals).reshape(-1, 6)
        error, covariance = drive.loose.take_constants()
        installation = replace(
            drive.installation.corrected(error), sd=np.sqrt(np.diag(covariance))
        )
        still = out.pop("still").astype(np.bool_)
        return Track(
            time=self.imu.time_end[self._rows[1 : still.size + 1] - 1],
            still=still,
            fix_time=fixes[:, 0],
            fix_free_up=fixes[:, 1],
            fix_up=fixes[:, 2],
            innovations=tuple(drive.innovations),
            residual_b=residuals[:, :3],
            turn_b=residuals[:, 3:],
            installation=installation,
            nav=drive.loose.nav,
            **out,
        )


def _mean_down(window: _Window) -> float:
    """Return the mean vertical velocity of the mechanisation over a window [m/s]."""
    down = np.append(window.before.vel_n[2], window.passed.vel_n[:, 2])
    return float(np.trapezoid(down) / (down.size - 1))


def _within(time: float, spans: tuple[Span, ...]) -> bool:
    return any(begin <= time < end for begin, end in spans)
