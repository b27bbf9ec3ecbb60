"""What the pictures of a simulated run are drawn from: collected on the way, bounded memory."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from scipy.signal import welch

from deepseis_bringup.simulation.envelope import Envelope, window_of
from deepseis_core.constants import L1_WAVELENGTH
from deepseis_core.if_format import IfFormat
from deepseis_core.types import FloatArray, IfBlock, IntArray, Pvt, Truth
from deepseis_sim.bench import Bench
from deepseis_sim.bench_streams import Item
from deepseis_sim.response_spectrum import ResponseSpectrum, response_spectrum

TRACK_POINTS: Final = 5000
ORBIT_POINTS: Final = 500
"""Samples of what the satellites' own motion does to the Doppler."""
SPECTRUM_HZ: Final = 200.0
LONGEST_SPECTRUM: Final = 400.0
"""Length of the motion that the response spectrum covers [s]."""
PERIODS: Final = np.geomspace(0.02, 10.0, 120)
IF_SECONDS: Final = 0.1
SEGMENT: Final = 4096


class Pictures:
    """Listens to what the bench puts out.

    Parameters
    ----------
    bench : Bench
        The run.

    Attributes
    ----------
    position, velocity, acceleration : Envelope
        Of the antenna against where it stood, east, north, up [m, m/s, m/s^2].
    imu : Envelope
        Angular rate [rad/s] and specific force [m/s^2] as measured, forward, left, up.
    ldv : Envelope
        Forward and vertical velocity [m/s] as measured.
    fixes : Envelope
        Errors of the positions that are given, east, north, up [m].
    cn0, doppler : Envelope
        C/N0 [dB-Hz] and carrier Doppler [Hz] of the satellites.
    window : tuple of float
        First and last moment of these records [s]; C/N0 and positions cover the whole run.
    """

    def __init__(self, bench: Bench) -> None:
        self.bench, duration = bench, bench.scenario.duration
        self.window = window_of(bench.motion.span, duration)
        self.position, self.velocity = Envelope(*self.window, 3), Envelope(*self.window, 3)
        self.acceleration = Envelope(*self.window, 3)
        self.imu, self.ldv = Envelope(*self.window, 6), Envelope(*self.window, 2)
        self.fixes = Envelope(0.0, duration, 3)
        self.satellites = tuple(item.satellite for item in bench.model.satellites)
        self.cn0 = Envelope(0.0, duration, len(self.satellites))
        self.doppler = Envelope(*self.window, len(self.satellites))
        rate = bench.scenario.truth_rate_hz
        self._track_step = max(1, round((self.window[1] - self.window[0]) * rate / TRACK_POINTS))
        self._shaking_step = max(1, round(rate / SPECTRUM_HZ))
        self.shaking_step = self._shaking_step / rate
        self._track: list[FloatArray] = []
        self._shaking: list[FloatArray] = []
        self._orbits: list[FloatArray] = []
        self._rows = 0
        self._if_data: list[Any] = []
        self._if_samples = 0

    def add(self, item: Item) -> None:
        """Take in a value."""
        if item.topic == "truth":
            self._add_truth(item.value)
        elif item.topic == "imu/data_raw":
            imu = item.value
            rates = np.concatenate([imu.angular_velocity, imu.linear_acceleration])
            self.imu.push(item.offset_ns / 1e9, rates)
        elif item.topic == "ldv/velocity":
            ldv = item.value
            velocity = np.array([ldv.forward_velocity, ldv.vertical_velocity])
            self.ldv.push(item.offset_ns / 1e9, velocity)
        elif item.topic == "gnss/pvt":
            self._add_fix(item.value)
        elif item.topic == "if/samples":
            self._add_block(item.value)

    def _add_truth(self, truth: Truth) -> None:
        t = truth.sample_index / self.bench.sample_rate_hz
        C = self.bench.site.C_e_enu
        position = (truth.position_ecef - self.bench.antenna_ecef) @ C
        acceleration = truth.acceleration_ecef @ C
        self.position.add(t, position)
        self.velocity.add(t, truth.velocity_ecef @ C)
        self.acceleration.add(t, acceleration)
        satellite_t = truth.satellite_sample_index / self.bench.sample_rate_hz
        self.cn0.add(satellite_t, truth.cn0_dbhz)
        self.doppler.add(satellite_t, truth.carrier_doppler_hz)
        self._add_orbits(truth, satellite_t)
        number = self._rows + np.arange(t.size)
        self._rows += t.size
        start, end = self.window
        thin = (number % self._track_step == 0) & (t >= start) & (t <= end)
        self._track.append(np.column_stack([t[thin], position[thin]]))
        begin = self.bench.motion.span[0]
        shaken = (t >= begin) & (t < begin + LONGEST_SPECTRUM)
        chosen = shaken & (number % self._shaking_step == 0)
        self._shaking.append(acceleration[chosen])

    def _add_orbits(self, truth: Truth, t: FloatArray) -> None:
        """Keep now and then the Doppler that is left when the antenna's velocity is taken off."""
        last = self._orbits[-1][0] if self._orbits else -np.inf
        if not t.size or not truth.sample_index.size:
            return
        if t[0] - last < self.bench.scenario.duration / ORBIT_POINTS:
            return
        (elevation,), (azimuth,) = self.bench.sky.directions(t[:1])
        flat = np.cos(elevation)
        towards = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)])
        row = min(
            int(np.searchsorted(truth.sample_index, truth.satellite_sample_index[0])),
            truth.sample_index.size - 1,
        )
        nearing = truth.velocity_ecef[row] @ self.bench.site.C_e_enu @ towards
        own = truth.carrier_doppler_hz[0] - nearing / L1_WAVELENGTH
        self._orbits.append(np.append(t[0], own))

    def _add_fix(self, fix: Pvt) -> None:
        """Keep how far a position is off."""
        t = np.array([fix.sample_index / self.bench.sample_rate_hz])
        (true,) = self.bench.model.antenna(t - self.bench.clock(t))
        self.fixes.push(float(t[0]), (fix.position_ecef - true) @ self.bench.site.C_e_enu)

    def _add_block(self, block: IfBlock) -> None:
        middle = sum(self.window) / 2.0
        if block.sample_index < middle * block.sample_rate_hz - block.sample_count:
            return
        if self._if_samples < IF_SECONDS * block.sample_rate_hz:
            self._if_data.append(block.data)
            self._if_samples += block.sample_count

    @property
    def track(self) -> FloatArray:
        """Way of the antenna in the window, thinned: time [s], east, north, up [m], (n, 4)."""
        return np.concatenate(self._track) if self._track else np.zeros((0, 4))

    @property
    def orbits(self) -> FloatArray:
        """Times [s] and the Doppler [Hz] of each satellite at an antenna at rest, (n, 1 + s)."""
        return np.array(self._orbits).reshape(-1, 1 + len(self.satellites))

    def response(self, damping: float = 0.05) -> list[ResponseSpectrum]:
        """Return the response spectra of east, north, up at `PERIODS`."""
        shaking = np.concatenate(self._shaking) if self._shaking else np.zeros((0, 3))
        if len(shaking) < 10 or not np.any(shaking):
            return []
        step = self.shaking_step
        return [response_spectrum(shaking[:, k], step, PERIODS, damping) for k in range(3)]

    def if_levels(self) -> tuple[FloatArray, FloatArray]:
        """Return some quantised samples of the middle of the run, I and Q (zeros if real)."""
        packing: IfFormat = self.bench.front_end.format
        data = np.concatenate(self._if_data) if self._if_data else np.zeros(0, np.uint8)
        out_i = np.zeros(self._if_samples, packing.dtype)
        out_q = np.zeros(self._if_samples, packing.dtype)
        packing.unpack(data, out_i, None if packing.is_real else out_q)
        return out_i.astype(np.float64), out_q.astype(np.float64)

    def if_spectrum(self) -> tuple[FloatArray, FloatArray]:
        """Return frequency from L1 [Hz] and power density against its median [dB]."""
        i, q = self.if_levels()
        if i.size < SEGMENT:
            return np.zeros(0), np.zeros(0)
        front_end = self.bench.front_end
        real = front_end.format.is_real
        samples = i if real else i + 1j * q
        f, power = welch(
            samples, front_end.sample_rate_hz, nperseg=SEGMENT, return_onesided=real,
            detrend=False,
        )  # fmt: skip
        order = np.argsort(f)
        f, power = f[order] - front_end.intermediate_frequency_hz, power[order]
        if front_end.format.inverted:
            f, power = -f[::-1], power[::-1]
        return f, 10.0 * np.log10(power / np.median(power))

    def level_counts(self) -> tuple[IntArray, IntArray]:
        """Return the quantiser's levels and how often each was used, I and Q together."""
        i, q = self.if_levels()
        values = i if self.bench.front_end.format.is_real else np.concatenate([i, q])
        levels, counts = np.unique(values.astype(np.int64), return_counts=True)
        return levels, counts

    def figures(self) -> dict[str, float]:
        """Return the peaks of the motion for the summary."""
        peaks: dict[str, float] = {}
        quantities = (
            ("peak_acceleration_mps2", self.acceleration),
            ("peak_velocity_mps", self.velocity),
            ("peak_displacement_m", self.position),
        )
        for name, envelope in quantities:
            for k, component in enumerate(("east", "north", "up")):
                peaks[f"{name}.{component}"] = round(envelope.peak(k), 6)
        return peaks
