"""What perfect tracking channels would say of a made-up constellation, seen through RTKLIB's eyes.

Orbits, clocks and atmosphere come from RTKLIB (pyrtklib), the light-time equation from here, so
nothing of the code under test goes into its input.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache

import numpy as np
import pyrtklib as rtk

from deepseis_core.types import Ephemeris, TrackingEpochs, TrackingFlag, TrackingMode

C = 299792458.0
L1_HZ = 1575.42e6
EARTH_RATE = 7.2921151467e-5
WEEK, TOW = 2190, 525618
STATION = np.array([-3959783.0, 3352586.0, 3697489.0])  # Tokyo, about 30 m above the ellipsoid
KLOBUCHAR = np.array(
    [1.1176e-8, 7.4506e-9, -5.9605e-8, -5.9605e-8, 9.0112e4, 0.0, -1.9661e5, -6.5536e4]
)
LOCKED = (
    TrackingFlag.CODE_LOCK
    | TrackingFlag.PHASE_LOCK
    | TrackingFlag.BIT_SYNC
    | TrackingFlag.POLARITY_KNOWN
)
NODES = 0.01 * (1.0 - np.cos(np.pi * (np.arange(4) + 0.5) / 4))
"""Chebyshev nodes of a 20 ms integration [s]."""


def ephemeris(prn: int) -> Ephemeris:
    """Return one of 32 satellites in six planes, with clocks, eccentricity and harmonics."""
    plane, slot = (prn - 1) % 6, (prn - 1) // 6
    return Ephemeris(
        satellite=f"G{prn:02d}",
        week=WEEK,
        toe=518400.0 + 7200.0,
        toc=518400.0 + 7200.0,
        af0=(-1) ** prn * prn * 1.3e-5,
        af1=(prn - 16) * 4e-13,
        af2=0.0,
        tgd=-prn * 3e-10,
        sqrt_a=5153.65 + 0.01 * prn,
        eccentricity=0.002 + 0.0004 * prn,
        i0=0.96 + 0.001 * slot,
        omega0=(2.2 + plane * np.pi / 3.0 + np.pi) % (2 * np.pi) - np.pi,
        omega=0.3 * prn,
        m0=(1.0 + slot * 1.17 + plane * 0.33 - 0.3 * prn + np.pi) % (2 * np.pi) - np.pi,
        delta_n=4.5e-9,
        omega_dot=-8.0e-9,
        i_dot=1e-10,
        cuc=1e-6, cus=8e-6, crc=220.0, crs=-30.0, cic=1e-7, cis=-5e-8,
        iode=prn, iodc=prn, transmit_tow=float(TOW),
    )  # fmt: skip


def rtklib_ephemeris(e: Ephemeris) -> rtk.eph_t:
    """Return the same for RTKLIB."""
    out = rtk.eph_t()
    out.sat = rtk.satno(rtk.SYS_GPS, int(e.satellite[1:]))
    out.week, out.toes, out.A, out.e = e.week, e.toe, e.sqrt_a**2, e.eccentricity
    out.toe, out.toc = rtk.gpst2time(e.week, e.toe), rtk.gpst2time(e.week, e.toc)
    out.ttr = rtk.gpst2time(e.week, e.transmit_tow)
    out.i0, out.OMG0, out.omg, out.M0 = e.i0, e.omega0, e.omega, e.m0
    out.deln, out.OMGd, out.idot = e.delta_n, e.omega_dot, e.i_dot
    out.cuc, out.cus, out.crc, out.crs, out.cic, out.cis = (
        *(e.cuc, e.cus, e.crc, e.crs, e.cic, e.cis),
    )
    out.f0, out.f1, out.f2 = e.af0, e.af1, e.af2
    out.tgd[0] = e.tgd
    out.iode, out.iodc, out.sva, out.svh, out.fit = e.iode, e.iodc, 0, 0, 4.0
    return out


def doubles(values: object) -> rtk.Arr1Ddouble:
    """Return a C array."""
    values = np.asarray(values, float).ravel()
    out = rtk.Arr1Ddouble(len(values))
    for i, value in enumerate(values):
        out[i] = float(value)
    return out


@dataclass
class Sky:
    """Signals at a receiver: ``tow(t)`` is the satellite's clock when it sent what arrives at t.

    ``position(t)`` gives the antenna [m]; times are seconds after TOW, in GPS time.
    """

    position: Callable[[float], np.ndarray] = lambda _: STATION
    atmosphere: bool = False
    _eph: dict[str, tuple[rtk.eph_t, float]] = field(default_factory=dict)

    def travel(self, satellite: str, t: float) -> tuple[float, float]:
        """Return receive time minus satellite clock, of code and of carrier [s]."""
        if satellite not in self._eph:
            made = ephemeris(int(satellite[1:]))
            self._eph[satellite] = rtklib_ephemeris(made), made.tgd
        eph, tgd = self._eph[satellite]
        here, flight = self.position(t), 0.075
        rs, clock, variance = rtk.Arr1Ddouble(3), rtk.Arr1Ddouble(1), rtk.Arr1Ddouble(1)
        for _ in range(4):
            rtk.eph2pos(rtk.gpst2time(WEEK, TOW + t - flight), eph, rs, clock, variance)
            turn = EARTH_RATE * flight
            x = np.cos(turn) * rs[0] + np.sin(turn) * rs[1]
            y = np.cos(turn) * rs[1] - np.sin(turn) * rs[0]
            line = np.array([x, y, rs[2]]) - here
            flight = float(np.sqrt(line @ line)) / C
        iono, tropo = self._delays(here, line / (flight * C), t) if self.atmosphere else (0, 0)
        base = flight - clock[0] + tgd
        return base + (tropo + iono) / C, base + (tropo - iono) / C

    def _delays(self, here: np.ndarray, e: np.ndarray, t: float) -> tuple[float, float]:
        when, pos, angles = rtk.gpst2time(WEEK, TOW + t), rtk.Arr1Ddouble(3), rtk.Arr1Ddouble(2)
        rtk.ecef2pos(doubles(here), pos)
        rtk.satazel(pos, doubles(e), angles)
        iono = rtk.ionmodel(when, doubles(KLOBUCHAR), pos, angles)
        return iono, rtk.tropmodel(when, pos, angles, 0.7)

    def elevation(self, satellite: str, t: float = 0.0) -> float:
        """Return the elevation [rad], roughly."""
        self.travel(satellite, 0.0)
        rs, clock, variance = rtk.Arr1Ddouble(3), rtk.Arr1Ddouble(1), rtk.Arr1Ddouble(1)
        when = rtk.gpst2time(WEEK, TOW + t)
        rtk.eph2pos(when, self._eph[satellite][0], rs, clock, variance)
        line = np.array([rs[0], rs[1], rs[2]]) - STATION
        return float(np.arcsin(line @ STATION / np.linalg.norm(line) / np.linalg.norm(STATION)))


@cache
def visible() -> tuple[str, ...]:
    """Return the satellites above 15 degrees."""
    names = [f"G{prn:02d}" for prn in range(1, 33)]
    sky = Sky()
    return tuple(name for name in names if sky.elevation(name) > np.radians(15.0))


def first_epoch(
    sky: Sky, t: float = 2.0, bias: float = 0.0
) -> tuple[np.ndarray, np.ndarray, list[Ephemeris]]:
    """Return exact pseudoranges [m], Doppler [Hz] and ephemerides at ``t`` seconds after TOW.

    The receiver's clock is ``bias`` metres ahead.
    """
    names, step = visible(), 0.01
    ranges = [C * sky.travel(name, t)[0] + bias for name in names]
    rates = [
        (sky.travel(name, t + step)[1] - sky.travel(name, t - step)[1]) / (2 * step)
        for name in names
    ]
    return np.array(ranges), -L1_HZ * np.array(rates), [ephemeris(int(n[1:])) for n in names]


@dataclass
class Receiver:
    """Tracking channels behind one sample clock.

    Sample 0 is taken ``start`` [s, whole milliseconds] after TOW; the clock gains
    ``clock_drift`` [s/s].
    """

    sky: Sky
    sample_rate_hz: float = 4e6
    clock_drift: float = 0.0
    start: float = 0.0

    def gps_time(self, sample: float) -> float:
        """Return GPS seconds after TOW of a sample."""
        return self.start + sample / self.sample_rate_hz * (1.0 - self.clock_drift)

    def rows(
        self, satellite: str, seconds: float, length: int, first_sample: int
    ) -> Iterator[dict[str, float]]:
        """Yield contiguous integrations; each NCO cubic interpolates the signal's phase."""
        for start in range(first_sample, int(seconds * self.sample_rate_hz) - length, length):
            tau = NODES * length / (0.02 * self.sample_rate_hz)
            at = start + tau * self.sample_rate_hz
            t = np.array([self.gps_time(s) for s in at])
            code, carrier = np.array([self.sky.travel(satellite, ti) for ti in t]).T
            # Everything below counts from sample time, which runs with the receiver's clock.
            drift = -self.clock_drift * at / self.sample_rate_hz
            phase = np.polynomial.Polynomial.fit(tau, L1_HZ * (drift - carrier), 3).convert().coef
            sent = np.polynomial.Polynomial.fit(tau, drift - code, 3).convert().coef
            # Time of week stays whole: a double of it would be off by centimetres.
            whole_ms, code_ms = divmod(1000.0 * (start / self.sample_rate_hz + sent[0]), 1.0)
            transmit_ms = TOW * 1000 + round(self.start * 1000) + int(whole_ms)
            yield {
                "sample_index": start,
                "sample_count": length,
                "transmit_ms": transmit_ms % 604_800_000,
                "code_phase_chips": code_ms * 1023,
                "code_rate_cps": 1.023e6 * (1 + sent[1]),
                "carrier_phase_cycles": phase[0] - np.round(L1_HZ * 0.07),
                "carrier_doppler_hz": phase[1],
                "carrier_doppler_rate": 2 * phase[2],
                "carrier_doppler_accel": 3 * phase[3],
            }

    def messages(
        self,
        satellite: str,
        seconds: float,
        integration_ms: int = 20,
        first_sample: int | None = None,
    ) -> list[TrackingEpochs]:
        """Return one satellite's messages, one per 20 ms block."""
        length = round(integration_ms * 1e-3 * self.sample_rate_hz)
        if first_sample is None:
            first_sample = int(satellite[1:]) * 1237 % length
        block = round(0.02 * self.sample_rate_hz)
        rows = list(self.rows(satellite, seconds, length, first_sample))
        out = []
        for first in range(0, int(seconds * self.sample_rate_hz), block):
            last = first + block - 1
            mine = [r for r in rows if first < r["sample_index"] + length <= last + 1]
            out.append(message(satellite, first, last, mine))
        return out


def message(
    satellite: str, first: int, last: int, rows: list[dict[str, float]], **fields: object
) -> TrackingEpochs:
    """Return a message of rows, everything else as in good reception."""
    n = len(rows)
    columns: dict[str, object] = {}
    for item in dataclasses.fields(TrackingEpochs):
        if item.name in rows[0] if rows else False:
            columns[item.name] = np.array([row[item.name] for row in rows])
        else:
            columns[item.name] = np.zeros(n, np.float32)
    for name in ("sample_index", "transmit_ms"):
        columns[name] = np.asarray(columns[name], np.int64)
    columns["sample_count"] = np.asarray(columns["sample_count"], np.int32)
    columns["cn0_dbhz"] = np.full(n, 45.0, np.float32)
    columns["phase_lock_indicator"] = np.ones(n, np.float32)
    columns["flags"] = np.full(n, int(LOCKED), np.uint16)
    columns |= {
        "satellite": satellite,
        "block_sample_index": first,
        "valid_through": last,
        "ephemeris_count": 0,
        "mode": TrackingMode.TRACK,
    }
    return TrackingEpochs(**{**columns, **fields})  # type: ignore[arg-type]
