"""Observations without IF samples: what the channels and the PVT of a good receiver would give.

From the delays of a `SignalModel` at the epochs of the receiver's GPS-time grid, with the errors
of `LoopNoise`::

    C1C = P - 293 m u_code + multipath,    L1C = N - (phi + u_carrier),    D1C = f + g e_carrier/T

phi is the model's carrier phase, so L1C grows with range. The integer N is chosen when an arc
begins so that L1C lies near C1C, as the real chain does. phi carries the satellite's initial
phase, the same for every receiver, and a fraction of this receiver, the same for every satellite:
differences between receivers *and* satellites have whole cycles.

A signal below the threshold is lost, at any integration between two epochs; once it has been
back for a while, a new arc begins with the loss-of-lock mark.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepseis_core.config import check, setting
from deepseis_core.constants import (
    CA_RATE_CPS,
    L1_WAVELENGTH,
    NS_PER_S,
    NS_PER_WEEK,
    SPEED_OF_LIGHT,
)
from deepseis_core.errors import InputError
from deepseis_core.types import Float32Array, FloatArray, IntArray, Lli, Observations, TrackingFlag
from deepseis_sim.loop_noise import (
    INTEGRATION,
    STEPS_PER_S,
    LoopNoise,
    carrier_sd_cycles,
    code_sd_chips,
    gain,
)
from deepseis_sim.signal_model import SignalModel

Cn0 = Callable[[FloatArray], FloatArray]
"""C/N0 [dB-Hz], shape (m, n_satellites), -inf where blocked, at receiver seconds since the start,
shape (m,)."""

CHIP: Final = SPEED_OF_LIGHT / CA_RATE_CPS
"""Length of a chip [m]."""
ROVER_STREAM: Final = 61
"""Number of the rover's random numbers."""
LOCKED: Final = int(
    TrackingFlag.CODE_LOCK
    | TrackingFlag.PHASE_LOCK
    | TrackingFlag.BIT_SYNC
    | TrackingFlag.POLARITY_KNOWN
)


@dataclass(frozen=True)
class ObservationConfig:
    """Settings of a receiver's observations.

    The bandwidths are those of the aided loops; C/N0 then sets the noise. A receiver known by
    its data sheet is set by levels instead, e.g. 5 m and 0.5 m/s of the car's receiver.
    """

    rate_hz: int = setting(50, "rate of observations, a divisor of 1e9 [Hz]", low=1, high=100)
    pll_bandwidth_hz: float = setting(8.0, "carrier loop's noise bandwidth [Hz]", low=0.1, high=25)
    dll_bandwidth_hz: float = setting(1.0, "code loop's noise bandwidth [Hz]", low=0.01, high=10)
    spacing_chips: float = setting(0.5, "early to late [chips]", low=0.02, high=1.9)
    threshold_dbhz: float = setting(25.0, "C/N0 below which lock is lost [dB-Hz]", low=10, high=60)
    reacquisition: float = setting(
        1.0, "from the signal's return to the next observation [s]", low=0.0, high=60.0
    )
    carrier_noise_scale: float = setting(1.0, "carrier noise over theory [-]", low=0.0, high=1e3)
    code_noise_scale: float = setting(1.0, "code noise over theory [-]", low=0.0, high=1e3)
    pseudorange_sd: float = setting(
        0.0, "sigma of the code loop's error; 0: by C/N0 [m]", low=0.0, high=1e3
    )
    pseudorange_mean: float = setting(0.0, "added to every pseudorange [m]", low=-1e4, high=1e4)
    range_rate_sd: float = setting(
        0.0, "sigma of the Doppler, white; 0: that of the carrier loop [m/s]", low=0.0, high=1e3
    )
    range_rate_mean: float = setting(0.0, "added to every range rate [m/s]", low=-1e3, high=1e3)
    multipath_sd: float = setting(
        0.0, "sigma of a Gauss-Markov error of the code, as of multipath [m]", low=0.0, high=1e3
    )
    multipath_tau: float = setting(60.0, "its correlation time [s]", low=0.1, high=1e5)

    @property
    def interval_ns(self) -> int:
        """Time between epochs [ns]."""
        return NS_PER_S // self.rate_hz


@dataclass(frozen=True)
class _Second:
    """Values at the m epochs of one second, shape (m, n) but for ``gps_ns``, (m,)."""

    gps_ns: IntArray
    pseudorange: FloatArray
    phase_cycles: FloatArray
    doppler_hz: FloatArray
    cn0_dbhz: FloatArray
    carrier_shown: FloatArray
    carrier_sd: FloatArray
    code_shown: FloatArray
    code_sd: FloatArray
    observed: NDArray[np.bool_]
    losses: IntArray


class ObservationModel:
    """One receiver's observations, epoch by epoch.

    Parameters
    ----------
    signals : SignalModel
        What reaches the antenna. Two receivers share ambiguities if their models have the same
        satellites and the same ``initial_phase_cycles``.
    config : ObservationConfig, optional
        Settings.
    cn0 : callable, optional
        C/N0 of the satellites; else that of the model.
    seed, stream : int, optional
        Of the noise; every receiver of a run needs a stream of its own.
    sample_rate_hz : float, optional
        Of the station's clock, in which ``sample_index`` counts [Hz].

    Raises
    ------
    InputError
        A setting makes no sense.
    """

    def __init__(
        self,
        signals: SignalModel,
        config: ObservationConfig | None = None,
        *,
        cn0: Cn0 | None = None,
        seed: int = 1,
        stream: int = ROVER_STREAM,
        sample_rate_hz: float = 4e6,
    ) -> None:
        self.signals, self.config = signals, config or ObservationConfig()
        _check(self.config)
        self.satellites = tuple(item.satellite for item in signals.satellites)
        self._cn0 = cn0 or signals.cn0_dbhz
        self._rate = Fraction(sample_rate_hz)
        self._seed = (seed, stream)
        # A fourth number: seeds that differ by zeros at their end alone are the same to NumPy.
        self.phase_fraction = float(np.random.default_rng([seed, stream, 0, 1]).random())
        interval = self.config.interval_ns
        self._start_ns = signals.start.total_ns
        self._first_ns = -(-self._start_ns // interval) * interval
        self._made: list[Observations] = []
        self._restart()

    def count(self, duration: float) -> int:
        """Return how many epochs there are in so many seconds from the start."""
        span = round(duration * NS_PER_S) - (self._first_ns - self._start_ns)
        return max(-(-span // self.config.interval_ns), 0)

    def epochs(self, first: int, count: int) -> Iterator[Observations]:
        """Yield epochs ``first .. first + count``; epoch 0 is the first at or after the start.

        Memory is that of one second. Going back begins anew, and going ahead makes what lies
        between: ask in order.
        """
        if first < 0:
            raise ValueError(f"there is no epoch {first}")
        for number in range(first, first + count):
            second, row = divmod(number, self.config.rate_hz)
            if second < self._second:
                self._restart()
            while self._second < second or not self._made:
                self._made = self._advance()
            yield self._made[row]

    def _restart(self) -> None:
        """Go back to before epoch 0."""
        c, n = self.config, len(self.satellites)
        self._wait = round(c.reacquisition * STEPS_PER_S)
        bandwidths = c.pll_bandwidth_hz, c.dll_bandwidth_hz
        self._noise = LoopNoise(n, bandwidths, c.multipath_tau, self._seed, self._wait)
        self._second, self._made = -1, []
        self._arc = np.full(n, -1, np.int64)  # number of losses before the arc; -1: none
        self._arc_cycles, self._arc_start_ns = np.zeros(n), np.zeros(n, np.int64)

    def _advance(self) -> list[Observations]:
        """Make the next second's epochs."""
        self._second += 1
        second = self._measure()
        return [self._epoch(second, row) for row in range(self.config.rate_hz)]

    def _measure(self) -> _Second:
        """Evaluate signals and noise at one second's epochs."""
        c, signals = self.config, self.signals
        number = self._second * c.rate_hz + np.arange(c.rate_hz)
        gps_ns = self._first_ns + number * c.interval_ns
        since_ns = gps_ns - self._start_ns
        # The integration that covers each epoch, and the time into it.
        step, rest_ns = np.divmod(since_ns - self._second * NS_PER_S, NS_PER_S // STEPS_PER_S)
        into = (rest_ns / NS_PER_S)[:, None]
        cn0_dbhz, carrier_sd, code_sd, weak = self._reception()
        errors = self._noise.advance(carrier_sd, code_sd, weak)
        carrier_hz = gain(c.pll_bandwidth_hz) / INTEGRATION * errors.carrier_shown[step]
        code_cps = gain(c.dll_bandwidth_hz) / INTEGRATION * errors.code_shown[step]
        code_error = c.multipath_sd * errors.slow[step]
        code_error -= CHIP * (errors.code[step] + into * code_cps)
        time = since_ns / NS_PER_S
        delays = signals.delays(time)
        phase = delays.carrier_phase_cycles + signals.initial_phase_cycles + self.phase_fraction
        doppler_hz = signals.carrier_doppler_hz(time) - c.range_rate_mean / L1_WAVELENGTH
        stated_hz = c.range_rate_sd / L1_WAVELENGTH * errors.rate[step]
        return _Second(
            gps_ns=gps_ns,
            pseudorange=delays.pseudorange + c.pseudorange_mean + code_error,
            phase_cycles=phase + errors.carrier[step] + into * carrier_hz,
            doppler_hz=doppler_hz + (stated_hz if c.range_rate_sd else carrier_hz),
            cn0_dbhz=cn0_dbhz[step],
            carrier_shown=errors.carrier_shown[step],
            carrier_sd=carrier_sd[step],
            code_shown=errors.code_shown[step],
            code_sd=code_sd[step],
            observed=errors.intact[step] > self._wait,
            losses=errors.losses[step],
        )

    def _reception(self) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
        """Return C/N0, the discriminators' sigmas and where it is too weak, per integration."""
        c = self.config
        middle = self._second + (np.arange(STEPS_PER_S) + 0.5) / STEPS_PER_S
        given = np.asarray(self._cn0(middle), np.float64)
        cn0_dbhz = np.broadcast_to(given, (STEPS_PER_S, len(self.satellites)))
        weak = ~(cn0_dbhz >= c.threshold_dbhz)
        # A loop without signal coasts; its error is not seen, but is where it is as that ends.
        tracked = np.where(weak, c.threshold_dbhz, cn0_dbhz)
        code_sd = c.code_noise_scale * code_sd_chips(tracked, c.spacing_chips)
        if c.pseudorange_sd > 0.0:
            loop = np.sqrt(2.0 * c.dll_bandwidth_hz * INTEGRATION)
            code_sd = np.full_like(tracked, c.pseudorange_sd / CHIP / loop)
        return cn0_dbhz, c.carrier_noise_scale * carrier_sd_cycles(tracked), code_sd, weak

    def _epoch(self, second: _Second, row: int) -> Observations:
        """Keep the arcs and return one epoch."""
        gps_ns = int(second.gps_ns[row])
        seen = np.flatnonzero(second.observed[row])
        pseudorange, phase = second.pseudorange[row], second.phase_cycles[row]
        new = seen[second.losses[row, seen] != self._arc[seen]]
        self._arc[new] = second.losses[row, new]
        self._arc_start_ns[new] = gps_ns
        self._arc_cycles[new] = np.rint(pseudorange[new] / L1_WAVELENGTH + phase[new])
        lli = np.zeros(len(self.satellites), np.uint8)
        lli[new] = Lli.SLIP
        sample, fraction = self._sample_at(gps_ns)
        week, tow_ns = divmod(gps_ns, NS_PER_WEEK)

        def single(values: FloatArray) -> Float32Array:
            return values[row, seen].astype(np.float32)

        return Observations(
            sample_index=sample,
            sample_fraction=fraction,
            week=week,
            tow_ns=tow_ns,
            valid_through=self._sample_at(gps_ns + self.config.interval_ns)[0] - 1,
            interval=self.config.interval_ns / NS_PER_S,
            satellites=tuple(self.satellites[i] for i in seen),
            pseudorange=pseudorange[seen],
            carrier_phase_cycles=self._arc_cycles[seen] - phase[seen],
            carrier_doppler_hz=second.doppler_hz[row, seen],
            cn0_dbhz=single(second.cn0_dbhz),
            lli=lli[seen],
            lock_time=((gps_ns - self._arc_start_ns[seen]) / NS_PER_S).astype(np.float32),
            carrier_error_cycles=single(second.carrier_shown),
            carrier_error_sd_cycles=single(second.carrier_sd),
            code_error_chips=single(second.code_shown),
            code_error_sd_chips=single(second.code_sd),
            flags=np.full(seen.size, LOCKED, np.uint16),
        )

    def _sample_at(self, gps_ns: int) -> tuple[int, float]:
        """Return the last whole sample at or before a receiver time, and the fraction after."""
        divisor = self._rate.denominator * NS_PER_S
        whole, rest = divmod((gps_ns - self._start_ns) * self._rate.numerator, divisor)
        return whole, rest / divisor


def _check(config: ObservationConfig) -> None:
    try:
        check(config)
    except ValueError as error:
        raise InputError("observations", str(error)) from None
    if NS_PER_S % config.rate_hz:
        hint = "such as 1, 2, 5, 10, 20, 25, 50, 100"
        raise InputError("observations", f"rate_hz = {config.rate_hz} divides 1e9 unevenly", hint)
