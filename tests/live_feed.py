"""A station's values for the live page: noise, an earthquake at a known time, nine satellites."""

from __future__ import annotations

import time

import numpy as np

from deepseis_bringup.live.model import LiveModel
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import (
    Displacement,
    DisplacementSource,
    InsSolution,
    MotionState,
    Observations,
    Pvt,
    SeismicEvent,
    Stamp,
    Station,
    TrackingEpochs,
)

START = GpsTime(2399, 259_200_000_000_000)
SAMPLE_RATE = 4_000_000
MONUMENT = np.array([-3_957_000.0, 3_310_000.0, 3_737_700.0])
SATELLITES = tuple(f"G{prn:02d}" for prn in (3, 5, 9, 12, 17, 22, 25, 28, 31))


class Feed:
    """Says what a graph would, 20 ms at a time; vectors in rows, flat, as messages hold them.

    ``quake_s``: an earthquake of 20 s begins then; its acceleration's greatest value is
    ``peak`` [m/s^2], in one sample, upwards, 4 s after the onset.
    """

    def __init__(
        self, model: LiveModel, rate: int = 200, quake_s: float = 1e9, peak: float = 19.6
    ):
        self.model, self.rate, self.quake_s, self.peak = model, rate, quake_s, peak
        self.rng = np.random.default_rng(7)
        self.step = 0
        model.take_station(
            Station("DSEI", "JP", MONUMENT, np.zeros(3), np.zeros(3), np.array([0, 0, 0, 1.0]),
                    imu="SPAN-FSAS")
        )  # fmt: skip

    @property
    def seconds(self) -> float:
        return self.step * 0.02

    def advance(self, seconds: float) -> None:
        """Say everything of some seconds."""
        for _ in range(round(seconds / 0.02)):
            self.block()

    def block(self) -> None:
        """Say everything of one block."""
        now_ns = time.time_ns()
        last = (self.step + 1) * SAMPLE_RATE // 50 - 1
        self.model.take_source(last, now_ns - 60_000_000)
        self.motion(last, now_ns)
        if self.step % 5 == 0:
            self.position(last)
        if self.step % 10 == 0:
            self.loops(last)
        if self.step % 50 == 0:
            self.slow(last)
        self.step += 1

    def shaking(self, times: np.ndarray) -> list[np.ndarray]:
        """Return acceleration, velocity, displacement: three tones that rise and fall."""
        since = times - self.quake_s
        size = np.where((since > 0) & (since < 20), np.exp(-(((since - 4) / 4) ** 2)), 0.0)
        out = [self.rng.normal(0.0, sd, (len(times), 3)) for sd in (4e-3, 3e-4, 3e-4)]
        for axis, (hz, part) in enumerate([(0.5, 0.3), (0.8, 0.25), (1.1, 0.15)]):
            rate = 2 * np.pi * hz
            for k, values in enumerate(out):
                wave = np.sin(rate * since - k * np.pi / 2)
                values[:, axis] += self.peak * part * size * wave / rate**k
        out[0][np.abs(since - 4.0) < 0.25 / self.rate, 2] = self.peak
        out[2][:, 0] += 0.08 / (1 + np.exp(-2.0 * np.clip(since - 4, -50, 50)))  # it stays there
        return out

    def motion(self, last: int, now_ns: int) -> None:
        n = self.rate // 50
        tow_ns = START.tow_ns + self.step * 20_000_000 + np.arange(1, n + 1) * (10**9 // self.rate)
        times = self.seconds + np.arange(1, n + 1) / self.rate
        a, v, d = self.shaking(times)
        sd = np.full((n, 3), [8e-4, 9e-4, 1.6e-3], np.float32)
        fused = Displacement(
            int(DisplacementSource.FUSED), False, last, 1 / self.rate, tow_ns, START.week,
            d.ravel(), v.ravel(), a.ravel(), sd.ravel(), 2 * sd.ravel(), 10 * sd.ravel(),
        )  # fmt: skip
        self.model.take_displacement(fused, now_ns)
        unknown = np.full((1, 3), np.nan)
        alone = d[-1:] + self.rng.normal(0.0, 1.5e-3, (1, 3))
        gnss = Displacement(
            int(DisplacementSource.GNSS), False, last, 0.02, tow_ns[-1:], START.week, alone[0],
            unknown[0], unknown[0], sd[0], sd[0], sd[0],
        )  # fmt: skip
        self.model.take_displacement(gnss, now_ns)
        self.solution(last, tow_ns, a, v, d)

    def solution(self, last, tow_ns, a, v, d) -> None:
        n, updates = len(tow_ns), int(self.step % 5 == 4)
        index = last - np.arange(n)[::-1] * (SAMPLE_RATE // self.rate)
        sd = np.r_[[1e-3] * 3, [2e-3] * 3, [2e-4] * 3, [1e-6] * 3, [3e-4] * 3].astype(np.float32)
        z = self.rng.normal(0.0, 1.0, (updates, 6)).astype(np.float32)
        none, ratio = np.zeros(0), np.ones_like(z).ravel()
        self.model.take_solution(
            InsSolution(
                "imu_link", 0, False, last, index, tow_ns, START.week, d.ravel(), v.ravel(),
                np.zeros(4 * n), a.ravel(), np.full(3 * n, 2e-7), np.full(3 * n, 4e-4), none,
                none, np.tile(sd, n), 15, index[:updates], z.ravel(), ratio, 6,
                np.ones(updates, bool),
            )
        )  # fmt: skip

    def position(self, last: int) -> None:
        n = len(SATELLITES)
        tow_ns = START.tow_ns + self.step * 20_000_000
        self.model.take_pvt(
            Pvt(
                last, START.week, tow_ns, last, 1, MONUMENT, np.zeros(3), 0.0, 0.1, np.eye(3),
                np.eye(3), SATELLITES, np.full(n, 0.4, np.float32), np.zeros(n, np.float32),
                np.linspace(0.2, 1.4, n).astype(np.float32),
                np.linspace(0.3, 6.0, n).astype(np.float32), pdop=1.9,
            )
        )  # fmt: skip
        none, flags = np.zeros(n), np.zeros(n, np.uint16)
        few = np.zeros(n, np.float32)
        lli = np.zeros(n, np.uint8)
        self.model.take_observations(
            Observations(
                last, 0.0, START.week, tow_ns, last, 0.02, SATELLITES, none, none, none, few,
                lli, few, few, few, few, few, flags,
            )
        )  # fmt: skip

    def loops(self, last: int) -> None:
        for k, satellite in enumerate(SATELLITES):
            aided = k < 7
            one, small = np.ones(1), np.ones(1, np.float32)
            self.model.take_tracking(
                TrackingEpochs(
                    satellite, last - 79_999, last, 1, 4 if aided else 3, np.array([last]),
                    np.array([80_000], np.int32), np.array([0]), one, one, one, 1000 * one, one,
                    one, small, small, small, small, small, small, small, small,
                    np.float32([46.0 - k + self.rng.normal(0, 0.3)]), 0.97 * small,
                    small * (1 if aided else np.nan), 0.0 * small, np.array([15], np.uint16),
                )
            )  # fmt: skip

    def slow(self, last: int) -> None:
        start_ns = START.to_utc_ns()
        utc_ns = start_ns + self.step * 20_000_000
        since = self.seconds - self.quake_s
        moving = 0 < since < 20
        ratio = np.full(6, 4.0 if moving else 0.2, np.float32)
        self.model.take_motion_state(
            MotionState(
                last, last, 2 if moving else 1, "variances", ratio, np.ones(6, np.float32)
            ),
            utc_ns,
        )
        if since > 0:
            onset = start_ns + round(self.quake_s * 1e9)
            stamp = Stamp(onset // 10**9, onset % 10**9)
            event = SeismicEvent(
                "DSEI-1", stamp, since > 20, 31.4, 0.213, 0.62, self.peak, 42_000.0, 6.1, 0.2
            )
            self.model.take_event(event, utc_ns)
        names = ("acquisition", "fusion", "if_source", "pvt", "recorder", "trackers")
        for name in names:
            self.model.take_diagnostic(name, 0, "works as it should", {"misses": "0"})
