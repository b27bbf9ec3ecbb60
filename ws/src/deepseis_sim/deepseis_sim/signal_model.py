"""What reaches the antenna: delay and carrier phase of every satellite at any receiver time.

Sample n is taken when the receiver's clock shows ``t_r = start + n / fs``; true GPS time is then
``t = t_r - b(t_r)``, b the clock's bias. With the geometric range rho (propagation), troposphere
T, ionosphere I [m] and the satellite's clock dt_s (design, section 1)::

    pseudorange   P   = rho + I + T + c (b - dt_s)              the code's delay
    carrier phase phi = -f1/c (rho - I + T) - f1 (b - dt_s) + phi0

The signal's code and data are those of the satellite's time ``t_r - P / c``.

For the synthesis both are laid out as cubics through four moments of each 10 ms segment (its
ends, shared with the neighbours, and its quarters): at 2 g and 2 Hz their error is 3e-9 m.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deepseis_core.atmosphere import klobuchar_delay, saastamoinen_delay
from deepseis_core.constants import CA_RATE_CPS, L1_HZ, L1_WAVELENGTH, NS_PER_S, SPEED_OF_LIGHT
from deepseis_core.ephemeris import pack
from deepseis_core.geodesy import geodetic_from_ecef
from deepseis_core.gps_time import GpsTime
from deepseis_core.propagation import LineOfSight, line_of_sight
from deepseis_core.types import FloatArray
from deepseis_sim.constellation import VisibleSatellite
from deepseis_sim.if_synthesis import SignalSegments
from deepseis_sim.multipath import HALF_CYCLE, MultipathConfig
from deepseis_sim.nav_data import NavData
from deepseis_sim.slow_table import SlowTable

Trajectory = Callable[[FloatArray], FloatArray]
"""Antenna ECEF [m], shape (m, 3), at true seconds since the start, shape (m,). It must answer for
some seconds before the start and after the end as well."""

ClockBias = Callable[[FloatArray], FloatArray]
"""Receiver clock ahead of GPS time [s] at receiver seconds since the start, shape (m,)."""

PERIOD_NS = 1_000_000
ATMOSPHERE_STEP = 10.0
"""The atmosphere is evaluated on a grid of so many seconds and is a cubic between (off by less
than 1e-6 m). That takes the edge off the step of 2 % that Klobuchar's cosine makes where it goes
over into the constant of the night, which a carrier loop would take for a cycle slip."""

_NODES = np.array([0.0, 0.25, 0.75, 1.0])
_CUBIC_FROM_NODES = np.linalg.inv(np.vander(_NODES, increasing=True))
_DIFFERENCE_STEP = 5e-4


def still(position_ecef: FloatArray) -> Trajectory:
    """Return the trajectory of an antenna that does not move."""
    position = np.asarray(position_ecef, np.float64)

    def trajectory(time: FloatArray) -> FloatArray:
        return np.broadcast_to(position, (time.size, 3))

    return trajectory


def linear_clock(bias: float, drift: float) -> ClockBias:
    """Return a receiver clock with a bias [s] and a constant drift [s/s]."""

    def clock(time: FloatArray) -> FloatArray:
        return bias + drift * time

    return clock


@dataclass(frozen=True)
class Delays:
    """Parts of the signals' delay [m, s] and the satellites' directions [rad].

    Their shape is (m, n_satellites), but for ``receiver_clock``, (m,).
    """

    range: FloatArray
    satellite_clock: FloatArray
    ionosphere: FloatArray
    troposphere: FloatArray
    receiver_clock: FloatArray
    elevation: FloatArray
    azimuth: FloatArray

    @property
    def _clocks(self) -> FloatArray:
        return self.receiver_clock[:, None] - self.satellite_clock

    @property
    def pseudorange(self) -> FloatArray:
        """Delay of the code [m]."""
        path = self.range + self.ionosphere + self.troposphere
        return path + SPEED_OF_LIGHT * self._clocks

    @property
    def carrier_phase_cycles(self) -> FloatArray:
        """Phase of the baseband carrier, phi0 zero [cycles]."""
        path = self.range - self.ionosphere + self.troposphere
        return -path / L1_WAVELENGTH - L1_HZ * self._clocks


class SignalModel:
    """Signals of several satellites at one antenna.

    Parameters
    ----------
    satellites : sequence of VisibleSatellite
    start : GpsTime
        Of the receiver's clock at sample 0.
    antenna : Trajectory
    clock : ClockBias, optional
        Receiver clock; else it is right.
    ionosphere, troposphere : bool, optional
        Klobuchar with the ephemeris' parameters; Saastamoinen at 70 % humidity.
    seed : int, optional
        Of the carriers' initial phases.
    cn0 : callable, optional
        C/N0 [dB-Hz], shape (m, n_satellites), at seconds since the start, shape (m,), such as
        `Sky.cn0_dbhz`; minus infinity: no signal. Else it is that of the satellites, unchanging.

    Attributes
    ----------
    initial_phase_cycles : ndarray, shape (n_satellites,)
    """

    def __init__(
        self,
        satellites: Sequence[VisibleSatellite],
        start: GpsTime,
        antenna: Trajectory,
        *,
        clock: ClockBias | None = None,
        ionosphere: bool = True,
        troposphere: bool = True,
        seed: int = 0,
        cn0: Callable[[FloatArray], FloatArray] | None = None,
    ) -> None:
        self.satellites = tuple(satellites)
        self._cn0 = cn0
        self.start, self.antenna = start, antenna
        self.clock = clock or linear_clock(0.0, 0.0)
        self._packed = pack([item.ephemeris for item in satellites])
        self._atmosphere = (ionosphere, troposphere)
        self._atmosphere_table = SlowTable(self._atmosphere_grid, ATMOSPHERE_STEP)
        self._nav = [NavData(item.ephemeris, start.week) for item in satellites]
        rng = np.random.default_rng([seed, 1])
        self.initial_phase_cycles = rng.random(len(self.satellites))

    def delays(self, time: FloatArray) -> Delays:
        """Evaluate the delays at receiver seconds since the start, shape (m,)."""
        bias = self.clock(time)
        return self._delays(time, bias, self._line_of_sight(time, bias, self._at(time - bias)))

    def carrier_phase_cycles(self, time: FloatArray) -> FloatArray:
        """Return the carriers' phases, shape (m, n_satellites)."""
        return self.delays(time).carrier_phase_cycles + self.initial_phase_cycles

    def carrier_doppler_hz(self, time: FloatArray) -> FloatArray:
        """Return the carriers' Doppler, shape (m, n_satellites)."""
        return self.delays_and_doppler(time)[1]

    def delays_and_doppler(self, time: FloatArray) -> tuple[Delays, FloatArray]:
        """Evaluate the delays and the carriers' Doppler [Hz] together: half the work.

        With d the clock's rate and f the Doppler by a perfect clock, ``phi' = f (1 - d) - f1 d -
        (T' - I') / lambda``. The antenna's velocity, d and the atmosphere's rates are central
        differences over 1 ms: 5e-5 Hz off at 2 g and 2 Hz.
        """
        h, bias = _DIFFERENCE_STEP, self.clock(time)
        true = time - bias
        velocity = (self._at(true + h) - self._at(true - h)) / (2.0 * h)
        los = self._line_of_sight(time, bias, np.append(self._at(true), velocity, axis=1))
        rate = (self.clock(time + h) - self.clock(time - h))[:, None] / (2.0 * h)
        air = (self._atmosphere_table(time + h) - self._atmosphere_table(time - h)) / (2.0 * h)
        doppler = los.doppler_hz * (1.0 - rate) - L1_HZ * rate
        doppler -= (air[:, 1] - air[:, 0]) / L1_WAVELENGTH
        return self._delays(time, bias, los), doppler

    def _at(self, true: FloatArray) -> FloatArray:
        return np.asarray(self.antenna(true), np.float64)[:, :3]

    def _line_of_sight(
        self, time: FloatArray, bias: FloatArray, receiver: FloatArray
    ) -> LineOfSight:
        whole = np.floor(time * NS_PER_S)
        return line_of_sight(
            self._packed,
            self.start.week,
            self.start.tow_ns + whole.astype(np.int64),
            np.ascontiguousarray(receiver),
            offset=time - whole / NS_PER_S - bias,
        )

    def _delays(self, time: FloatArray, bias: FloatArray, los: LineOfSight) -> Delays:
        ionosphere, troposphere = np.moveaxis(self._atmosphere_table(time), 1, 0)
        return Delays(
            los.range,
            los.satellite_clock,
            ionosphere,
            troposphere,
            bias,
            los.elevation,
            los.azimuth,
        )

    def cn0_dbhz(self, time: FloatArray) -> FloatArray:
        """Return the satellites' C/N0 [dB-Hz], shape (m, n_satellites)."""
        if self._cn0 is not None:
            return self._cn0(time)
        given = np.array([item.cn0_dbhz for item in self.satellites])
        return np.broadcast_to(given, (time.size, given.size))

    def signal_prn(self, multipath: MultipathConfig | None = None) -> list[int]:
        """Return the codes of the rows of `segments`."""
        reflected = self._reflected(multipath)
        return [item.prn for item in [*self.satellites, *(self.satellites[k] for k in reflected)]]

    def carriers_hz(
        self, time: FloatArray, multipath: MultipathConfig | None = None
    ) -> FloatArray:
        """Return the sum of C/N0 of satellites and reflections [Hz] at seconds (m,)."""
        cn0 = 10.0 ** (self.cn0_dbhz(time) / 10.0)
        gain = 10.0 ** (multipath.gain_db / 10.0) if multipath else 0.0
        return np.asarray(cn0.sum(axis=1) + gain * cn0[:, self._reflected(multipath)].sum(axis=1))

    def segments(
        self, first: int, count: int, span: float, multipath: MultipathConfig | None = None
    ) -> SignalSegments:
        """Lay out phases and data for segments ``first .. first + count`` of ``span`` seconds.

        Rows are the satellites, then the reflections of those concerned.
        """
        number = np.arange(first, first + count, dtype=np.float64)
        time = np.append(((number[:, None] + _NODES[:3]) * span).ravel(), (first + count) * span)
        delays = self.delays(time)
        cn0 = self.cn0_dbhz((number + 0.5) * span)
        path, phase = delays.pseudorange, delays.carrier_phase_cycles + self.initial_phase_cycles
        reflected = self._reflected(multipath)
        if multipath is not None:
            extra = multipath.extra_path(delays.elevation, delays.azimuth)[:, reflected]
            path = np.append(path, path[:, reflected] + extra, axis=1)
            turned = phase[:, reflected] - extra / L1_WAVELENGTH + HALF_CYCLE
            phase = np.append(phase, turned, axis=1)
            # Behind the plane there is no reflection, in all of a segment that begins there.
            weak = np.where(extra[:-1:3] > 0.0, cn0[:, reflected] + multipath.gain_db, -np.inf)
            cn0 = np.append(cn0, weak, axis=1)
        sent = time[:, None] - path / SPEED_OF_LIGHT
        # Chips count from the code period in which the segment begins: no phase depends on where
        # the chunk of segments begins.
        begin = self.start.tow_ns + np.floor(sent[:-1:3] * NS_PER_S).astype(np.int64)
        period = begin // PERIOD_NS
        first_bit = period[0] // 20
        base = (self.start.tow_ns - period * PERIOD_NS) / NS_PER_S
        chips = _cubics(CA_RATE_CPS * sent)
        chips[..., 0] = CA_RATE_CPS * (sent[:-1:3] + base).T
        return SignalSegments(
            first,
            _cubics(phase),
            chips,
            np.ascontiguousarray((period - 20 * first_bit).T),
            np.ascontiguousarray(cn0.T),
            self._bits(first_bit, int(np.ceil(count * span / 0.02)) + 2, reflected),
        )

    def _reflected(self, multipath: MultipathConfig | None) -> list[int]:
        """Return the numbers of the satellites that have a reflection."""
        if multipath is None:
            return []
        return [k for k, item in enumerate(self.satellites) if multipath.concerns(item.satellite)]

    def _bits(
        self, first: NDArray[np.int64], count: int, reflected: Sequence[int]
    ) -> NDArray[np.uint8]:
        nav = [*self._nav, *(self._nav[k] for k in reflected)]
        rows = [item.bits(int(k), count) for item, k in zip(nav, first, strict=True)]
        return np.array(rows, np.uint8).reshape(len(rows), count)

    def _atmosphere_grid(self, number: int) -> FloatArray:
        """Return ionosphere and troposphere [m], shape (2, n), at one point of the grid."""
        time = np.array([number * ATMOSPHERE_STEP])
        position = np.array(self.antenna(time)[0, :3])
        when = self.start.add_ns(round(number * ATMOSPHERE_STEP * NS_PER_S))
        los = line_of_sight(self._packed, when.week, when.tow_ns, position)
        latitude, longitude, height = geodetic_from_ecef(position)
        elevation, azimuth = los.elevation.copy(), los.azimuth.copy()
        ionosphere, troposphere = np.zeros(elevation.size), np.zeros(elevation.size)
        for k, item in enumerate(self.satellites):
            alpha = np.array(item.ephemeris.iono_alpha)
            if self._atmosphere[0] and alpha.size:
                ionosphere[k] = klobuchar_delay(
                    alpha, np.array(item.ephemeris.iono_beta), latitude, longitude,
                    elevation[k : k + 1], azimuth[k : k + 1], when.tow_s(),
                )[0]  # fmt: skip
        if self._atmosphere[1]:
            troposphere = saastamoinen_delay(latitude, height, elevation)
        return np.stack([ionosphere, troposphere])


def _cubics(at_nodes: FloatArray) -> FloatArray:
    """Turn values at the nodes of k segments, shape (3 k + 1, n), into cubics (n, k, 4)."""
    begin = at_nodes[:-1:3]
    # Differences from the segment's beginning keep the digits of a phase of 1e8 cycles; plain
    # elementwise arithmetic keeps a segment's cubic independent of how many there are.
    d1, d2, d3 = at_nodes[1::3] - begin, at_nodes[2::3] - begin, at_nodes[3::3] - begin
    terms = [m[1] * d1 + m[2] * d2 + m[3] * d3 for m in _CUBIC_FROM_NODES[1:]]
    return np.ascontiguousarray(np.stack([begin, *terms], axis=-1).transpose(1, 0, 2))
