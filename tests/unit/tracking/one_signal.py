"""One satellite's signal by plain NumPy, tracked by a channel: what several tests share."""

import numpy as np

from deepseis_core.ca_code import ca_code
from deepseis_core.constants import CA_LENGTH, CA_RATE_CPS, L1_HZ
from deepseis_core.types import AcquisitionResult, Aiding
from deepseis_tracking.baseband_window import BasebandWindow
from deepseis_tracking.channel import Channel, TrackingConfig

RATE = 2.048e6
BLOCK = 40_960


class Signal:
    """One satellite: Doppler from a callable's integral, data bits, noise; complex baseband."""

    def __init__(self, cn0_dbhz=47.0, doppler_hz=1234.5, motion=None, seed=3, seconds=6.0):
        rng = np.random.default_rng(seed)
        self.bits = rng.choice([-1.0, 1.0], 1000)
        self.amplitude = np.sqrt(2 * 10 ** (cn0_dbhz / 10) / RATE)  # noise sigma 1 a component
        self.doppler_hz, self.motion, self.seed = doppler_hz, motion, seed
        self.start_chips = 345.6
        self.made = {}

    def phase_cycles(self, t):
        """Carrier phase."""
        phase = self.doppler_hz * t
        return phase + self.motion(t) if self.motion else phase

    def code_chips(self, t):
        """Code phase, coherent with the carrier."""
        return self.start_chips + CA_RATE_CPS * t + self.phase_cycles(t) * CA_RATE_CPS / L1_HZ

    def block(self, index):
        """Planar int8 samples of one block; made once for an amplitude."""
        key = index, self.amplitude
        if key not in self.made:
            self.made[key] = self._block(index)
        return self.made[key]

    def _block(self, index):
        n = index * BLOCK + np.arange(BLOCK)
        t = n / RATE
        chips = self.code_chips(t)
        bit = self.bits[(chips // (20 * CA_LENGTH)).astype(int)]
        code = ca_code(7)[(chips % CA_LENGTH).astype(int)]
        rng = np.random.default_rng([self.seed, index])
        noise = rng.normal(size=(2, BLOCK))
        wave = self.amplitude * bit * code * np.exp(2j * np.pi * self.phase_cycles(t))
        scale = 20.0
        return [
            np.clip(np.rint(scale * part), -127, 127).astype(np.int8)
            for part in (wave.real + noise[0], wave.imag + noise[1])
        ]

    def result(self, doppler_error_hz=4.0):
        """What an acquisition would say."""
        return AcquisitionResult(
            "G07", True, 0, 0, self.start_chips + 0.1, self.doppler_hz + doppler_error_hz,
            3.0, 50.0, 3.0, 1e-6, 45.0,
        )  # fmt: skip


def track(signal, seconds, config=None, aiding=None, blocks_at_once=1, result=None):
    """Track through a window; returns channel and epochs. ``aiding(block)``: None is a hole."""
    channel = Channel("G07", RATE, config or TrackingConfig())
    channel.hand_over(result or signal.result(), 0)
    window = BasebandWindow(BLOCK + 60_000)
    epochs = []
    for index in range(0, round(seconds / 0.02), blocks_at_once):
        parts = [signal.block(k) for k in range(index, index + blocks_at_once)]
        i, q = (np.concatenate([p[c] for p in parts]) for c in range(2))
        window.push(i, q, index * BLOCK)
        for k in range(index, index + blocks_at_once):
            if aiding is not None and (message := aiding(k)) is not None:
                channel.aid(message)
            elif aiding is not None:
                channel.aid_missing((k + 1) * BLOCK - 1)
        found, _ = channel.advance(window, index * BLOCK, -1)
        epochs.append(found)
    return channel, epochs


def column(epochs, name):
    """One column of all epochs."""
    return np.concatenate([getattr(e, name) for e in epochs])


def phase_error(signal, epochs):
    """NCO phase less truth at the middle of the integrations of the tracking modes, cycles."""
    tau = column(epochs, "sample_count") / RATE / 2
    phase = (
        column(epochs, "carrier_phase_cycles")
        + column(epochs, "carrier_doppler_hz") * tau
        + column(epochs, "carrier_doppler_rate") * tau**2 / 2
        + column(epochs, "carrier_doppler_accel") * tau**3 / 3
    )
    error = phase - signal.phase_cycles(column(epochs, "sample_index") / RATE + tau)
    return error[column(epochs, "sample_count") > 0.015 * RATE]


def half_cycle_free(error):
    """Distance from the nearest half cycle."""
    return error - np.round(2 * np.median(error)) / 2


def circle(t):
    """Carrier phase of a 12 cm circle at 2 Hz, line of sight in its plane, from rest at 3 s."""
    ramp = np.clip((t - 3.0) / 0.5, 0, 1)
    ramp = ramp**3 * (10 - 15 * ramp + 6 * ramp**2)
    return -0.12 / 0.1903 * ramp * np.sin(2 * np.pi * 2.0 * (t - 3.0))


def aiding_of(signal):
    """Aiding as the INS would give it: the Doppler of the motion, knots a millisecond apart."""

    def aid(block):
        step = round(RATE / 1000)
        count = BLOCK // step + 2
        knots = block * BLOCK + step * np.arange(count)
        t = knots / RATE
        h = 1e-5

        def doppler(time):
            return (signal.phase_cycles(time + h) - signal.phase_cycles(time - h)) / (2 * h)

        rate = (doppler(t + h) - doppler(t - h)) / (2 * h)
        return Aiding(
            "truth", block * BLOCK, (block + 1) * BLOCK - 1, True, int(knots[0]), step, count,
            ("G07",), doppler(t)[None, :], rate[None, :], float("nan"), np.zeros(1, np.float32),
        )  # fmt: skip

    return aid
