"""Recorded IMU and GNSS of `shared/data/gnss_ins` as the loosely coupled filter wants them."""

import csv
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np
from scipy.io import loadmat
from unit.pvt.rtklib_reference import epochs

from deepseis_core import geodesy, rotation
from deepseis_core.constants import L1_WAVELENGTH, SPEED_OF_LIGHT
from deepseis_core.ephemeris import pack, select_ephemerides, states_from_pseudoranges
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.types import Ephemeris
from deepseis_pvt.spp import SppConfig, SppSolver


@dataclass(frozen=True)
class Fix:
    """Position and velocity of the antenna, ECEF, and their sds north, east, down."""

    time: float
    position: np.ndarray
    velocity: np.ndarray
    position_sd: np.ndarray
    velocity_sd: np.ndarray
    satellites: tuple = ()


@dataclass(frozen=True)
class Log:
    """Increments forward-right-down, ends of their intervals, and fixes; one scale of time [s]."""

    time: np.ndarray
    dt: np.ndarray
    delta_theta: np.ndarray
    delta_vel: np.ndarray
    fixes: list


# PSINS: car, 200 Hz increments, right-front-up, with GPS ranges smoothed by phase.

_EPHEMERIS = (
    *("iode", "crs", "delta_n", "m0", "cuc", "eccentricity", "cus", "sqrt_a", "toe", "cic"),
    *("omega0", "cis", "i0", "crc", "omega", "omega_dot", "i_dot", "l2_code", "week"),
)


def _ephemeris(row):
    """Return one of a row in RINEX-2 order."""
    orbit = dict(zip(_EPHEMERIS, row[5:24].tolist(), strict=True))
    orbit |= {name: int(orbit[name]) for name in ("iode", "l2_code", "week")}
    return Ephemeris(f"G{int(row[0]):02d}", toc=row[1], af0=row[2], af1=row[3], af2=row[4],
                     tgd=row[27], **orbit)  # fmt: skip


def psins(folder):
    data = loadmat(folder / "psins" / "insgpseo_tc.mat")
    start, imu, observed = data["t0"].item(), data["imu"], data["obss"]
    known = {int(row[0]): _ephemeris(row) for row in data["ephs"] if row[12] > 5000.0}
    fixes = []
    for tow in np.unique(observed[observed[:, 0] >= start, 0]):
        rows = observed[(observed[:, 0] == tow) & np.isin(observed[:, 1], list(known))]
        # The last column is Doppler in metres a second, positive approaching.
        fix = _solved([known[int(prn)] for prn in rows[:, 1]], tow, rows[:, 2], rows[:, 5], None)
        fixes += [] if fix is None else [_shifted(fix, -start)]
    # Times of samples jitter by 2 ms about 5 ms: they were stamped, not taken, unevenly.
    dt = np.full(len(imu), (imu[-1, 6] - imu[0, 6]) / (len(imu) - 1))
    to_frd = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return Log(imu[0, 6] + np.cumsum(dt), dt, imu[:, :3] @ to_frd.T, imu[:, 3:6] @ to_frd.T, fixes)


def _solved(ephemerides, tow, pseudorange, doppler_ms, klobuchar, cn0=None):
    packed, ranges = pack(ephemerides), np.ascontiguousarray(pseudorange)
    states = states_from_pseudoranges(packed, ephemerides[0].week, round(tow * 1e9), ranges)
    cn0 = np.full(len(ranges), 45.0) if cn0 is None else cn0
    got = SppSolver(SppConfig()).solve(
        states, ranges, doppler_ms / L1_WAVELENGTH, cn0, tow=tow, klobuchar=klobuchar
    )
    if got is None or not got.consistent or not np.isfinite(got.velocity_ecef).all():
        return None
    C_ne = geodesy.rotation_ned_ecef(*geodesy.geodetic_from_ecef(got.position_ecef)[:2])
    sds = [
        np.sqrt(np.diag(C_ne @ P[:3, :3] @ C_ne.T))
        for P in (got.covariance, got.velocity_covariance)
    ]
    used = tuple(e.satellite for e, is_used in zip(ephemerides, got.used, strict=True) if is_used)
    time = tow - got.clock_bias / SPEED_OF_LIGHT
    return Fix(time, got.position_ecef, got.velocity_ecef, *sds, used)


def _shifted(fix, by):
    return replace(fix, time=fix.time + by)


# INSTINCT: still, VN310 at 50 Hz with z down, u-blox at 10 Hz.


def instinct(folder):
    folder = folder / "instinct_tckf_static"
    obs, nav = (next(folder.glob(name)) for name in ("*.23O", "*.nav"))
    navigation = read_rinex_nav(nav)
    klobuchar = np.array(navigation.iono_alpha + navigation.iono_beta)
    fixes = []
    for epoch in epochs(obs, nav):
        chosen = select_ephemerides(navigation.ephemerides, epoch.week, round(epoch.tow * 1e9))
        names = [name for name in epoch.values if name in chosen and epoch.values[name][0] > 0.0]
        values = np.array([epoch.values[name] for name in names])
        doppler = np.where(values[:, 2] == 0.0, np.nan, values[:, 2]) * L1_WAVELENGTH
        ephemerides = [chosen[name] for name in names]
        fix = _solved(ephemerides, epoch.tow, values[:, 0], doppler, klobuchar, values[:, 3])
        fixes += [] if fix is None else [fix]
    with (folder / "vn310-imu.csv").open() as file:
        rows = list(csv.DictReader(file))
    time = np.array([float(row["GpsTow [s]"]) for row in rows])
    rates, force = (
        np.array([[float(row[f"IMU::Uncomp{what}::{axis} [{unit}]"]) for axis in "XYZ"]
                  for row in rows])
        for what, unit in (("Gyro", "rad/s"), ("Accel", "m/s^2"))
    )  # fmt: skip
    dt = np.diff(time)  # samples hold over the interval to them; one gap of 0.3 s as well
    return Log(time[1:], dt, rates[1:] * dt[:, None], force[1:] * dt[:, None], fixes)


# Walk: hand-carried MEMS, u-blox F9P with RTK.

G = 9.80665
MOUNTING = np.radians([180.0, 0.0, -90.0])


def walk(folder):
    folder = folder / "GNSS_IMU_walk_0827"
    imu, fixes = np.loadtxt(folder / "imu_1730_sf.csv", delimiter=","), []
    start = imu[0, 0]
    for line in (folder / "gnss_1730_sf.pos").read_text().splitlines():
        if line.startswith("%"):
            continue
        date, clock, *texts = line.split()
        values = np.array([float(text) for text in texts])
        when = datetime.strptime(f"{date} {clock}000", "%Y/%m/%d %H:%M:%S.%f")
        place = np.array([*np.radians(values[:2]), values[2]])
        C_ne = geodesy.rotation_ned_ecef(*place[:2])
        vel_n = values[13:16] * [1.0, 1.0, -1.0]
        fixes.append(
            Fix(
                when.replace(tzinfo=UTC).timestamp() - start,
                geodesy.ecef_from_geodetic(place),
                C_ne.T @ vel_n,
                values[5:8],
                values[16:19],
            )
        )
    time = imu[:, 0] - start
    dt = np.diff(time)
    to_frd = rotation.matrix_from_euler(MOUNTING)
    # The mean over an interval from its ends.
    mean = 0.5 * (imu[1:, 1:7] + imu[:-1, 1:7])
    theta, vel = mean[:, 3:] @ to_frd.T, G * mean[:, :3] @ to_frd.T
    return Log(time[1:], dt, theta * dt[:, None], vel * dt[:, None], fixes)


def ended_before(log, seconds):
    """Tell how many increments end before a time."""
    return int(np.searchsorted(log.time, seconds))


def autocorrelation(values, lag=1):
    """Return the correlation of a series with itself, a column each."""
    x = values - values.mean(axis=0)
    return (x[lag:] * x[:-lag]).mean(axis=0) / (x * x).mean(axis=0)
