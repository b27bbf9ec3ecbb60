"""A laser Doppler velocimeter with two beams in its vertical plane: velocity over the ground.

Beam i leaves the sensor at the elevation ``e_i`` above its forward axis (negative: towards the
road) and measures the rate at which the ground comes nearer along it::

    d_i = (1 + s_i) (v_x cos e_i + v_z sin e_i) + noise

with v the velocity of the sensor's point over the ground, along the sensor's forward and up axes,
and s_i an error of scale. The two beams solve for v_x and v_z; the velocity across their plane is
not seen. The default looks forward and back at 60 degrees below the axis (Janus), which measures
the vertical, from which heights come, better than two beams to one side.

The quality factor follows the strength of the signal: above 100 the measurement is usable. It is
some hundreds when moving, low at rest, where no Doppler shift lifts the signal from the carrier's
noise, and in dropouts (wet or broken ground). Below 100 the beams are as much noisier.

References
----------
.. [1] Wei G. et al., Infrared and Laser Engineering 52(6), 2023: two beams under the vehicle's
   floor, 100 Hz, 1e-3 of the speed or better, quality factor above 100 when usable (figure 6).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray
from deepseis_sim.motion import Kinematics, Motion
from deepseis_sim.motions_shapes import check_settings

LDV_NOISE_STREAM: Final = 405
LDV_QUALITY_STREAM: Final = 406
LDV_DROPOUT_STREAM: Final = 407

BLOCK: Final = 1000
"""Samples whose random numbers are drawn together; how they are asked for changes nothing."""

USABLE: Final = 100.0
"""Quality factor from which a measurement is good."""

NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)


@dataclass(frozen=True)
class LdvConfig:
    """Settings of the velocimeter; axes forward, left, up."""

    rate_hz: float = setting(100.0, "measurements a second [Hz]", low=1.0, high=1000.0)
    elevation_deg: tuple[float, float] = setting(
        (-60.0, -120.0), "of each beam above the forward axis [deg]", low=-180.0, high=180.0
    )
    lever_arm: tuple[float, float, float] = setting(
        (0.0, 0.0, -0.6), "from the body's origin to the sensor [m]", low=-100.0, high=100.0
    )
    scale_error: tuple[float, float] = setting(
        (1e-3, 1e-3), "of each beam, relative [-]", low=-0.1, high=0.1
    )
    misalignment_deg: tuple[float, float, float] = setting(
        (0.1, -0.2, 0.3),
        "turn of the sensor in the body about forward, left, up; pitch > 0: beams lower [deg]",
        low=-45.0,
        high=45.0,
    )
    noise: float = setting(0.005, "of a beam, one sigma [m/s]", low=0.0, high=10.0)
    relative_noise: float = setting(
        5e-4, "further noise in proportion to a beam's velocity, one sigma [-]", low=0.0, high=0.1
    )
    quality: float = setting(300.0, "median of the quality factor when moving", low=1.0, high=1e5)
    dropouts_per_hour: float = setting(6.0, "spells of bad signal [1/h]", low=0.0, high=3600.0)
    dropout: float = setting(0.5, "mean length of such a spell [s]", low=0.01, high=60.0)


@dataclass(frozen=True)
class LdvSamples:
    """Measurements, m of them.

    Attributes
    ----------
    time, time_end : ndarray, shape (m,)
        Middle and end of the measuring interval, receiver time since the start [s].
    beam_velocity, beam_velocity_sd : ndarray, shape (m, 2)
        Mean over the interval, positive when the ground comes nearer, and its sigma [m/s].
    beam_elevation : ndarray, shape (2,)
        Nominal, above the forward axis [rad].
    forward_velocity, vertical_velocity : ndarray, shape (m,)
        Solved with the nominal geometry, along the sensor's forward and up axes [m/s].
    quality : ndarray, shape (m,)
        Above 100: usable.
    """

    time: FloatArray
    time_end: FloatArray
    beam_velocity: FloatArray
    beam_velocity_sd: FloatArray
    beam_elevation: FloatArray
    forward_velocity: FloatArray
    vertical_velocity: FloatArray
    quality: FloatArray


class LdvSynthesizer:
    """Measurements along a motion; each depends on its number alone.

    Measurement k is the mean over receiver time from k / rate to (k + 1) / rate.

    Parameters
    ----------
    config : LdvConfig
    motion : Motion
        Of the body, as a function of true time.
    seed : int
    clock : callable, optional
        Receiver time [s] to receiver minus true time [s], shape (m,); without it they agree.
    """

    def __init__(
        self,
        config: LdvConfig,
        motion: Motion,
        seed: int,
        *,
        clock: Callable[[FloatArray], FloatArray] | None = None,
    ) -> None:
        check_settings("ldv", config)
        self.config, self.motion, self.seed, self.clock = config, motion, seed, clock
        self.elevation: FloatArray = np.deg2rad(np.array(config.elevation_deg))
        self._beams = np.array([np.cos(self.elevation), np.sin(self.elevation)]).T
        if abs(np.linalg.det(self._beams)) < 0.05:
            first, second = config.elevation_deg
            raise InputError(
                "ldv",
                f"beams at {first:g} and {second:g} deg are almost parallel",
                "3 deg or more between their lines",
            )
        roll, pitch, yaw = config.misalignment_deg
        C_bd = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_matrix()
        # Forward and up of the sensor, then its beams with their scale, all from body axes.
        scale = 1.0 + np.array(config.scale_error)[:, np.newaxis]
        self._from_body = scale * (self._beams @ C_bd.T[[0, 2]])

    def chunk(self, first: int, count: int) -> LdvSamples:
        """Return measurements ``first`` to ``first + count``, the last excluded."""
        if first < 0 or count < 0:
            raise InputError("ldv samples", f"{count} from number {first}", "neither below 0")
        edges = np.arange(first, first + count + 1) / self.config.rate_hz
        velocity = self._mean_velocity(edges)
        truth = _each(self._from_body, velocity)
        quality = self._quality(first, np.linalg.norm(velocity, axis=1))
        sd = np.hypot(self.config.noise, self.config.relative_noise * truth)
        sd *= np.maximum(USABLE / quality, 1.0)[:, np.newaxis]
        beams = truth + sd * self._drawn(LDV_NOISE_STREAM, first, count, (BLOCK, 2))
        solved = _each(np.linalg.inv(self._beams), beams)
        middle = 0.5 * (edges[1:] + edges[:-1])
        return LdvSamples(
            middle, edges[1:], beams, sd, self.elevation, solved[:, 0], solved[:, 1], quality
        )

    def _mean_velocity(self, edges: FloatArray) -> FloatArray:
        """Return the sensor's velocity over the ground, body axes, mean between edges (m, 3)."""
        true = edges if self.clock is None else edges - self.clock(edges)
        half, middle = 0.5 * np.diff(true), 0.5 * (true[1:] + true[:-1])
        times = middle[:, np.newaxis] + half[:, np.newaxis] * NODES
        lever = np.array(self.config.lever_arm)
        velocity = ground_velocity(self.motion.at(times.ravel()), lever)
        return np.einsum("mkj,k->mj", velocity.reshape(-1, len(NODES), 3), 0.5 * WEIGHTS)

    def _quality(self, first: int, speed: FloatArray) -> FloatArray:
        """Return the quality factor: a slow log-normal walk, low at rest and in dropouts."""
        count = speed.size
        per_second = max(round(self.config.rate_hz), 1)
        number = np.arange(first, first + count) / per_second
        begin = math.floor(number[0]) if count else 0
        end = math.floor(number[-1]) + 2 if count else 2
        knots = self._drawn(LDV_QUALITY_STREAM, begin, end - begin, (BLOCK,))
        walk = np.interp(number, np.arange(begin, end), knots)
        moving = speed**2 / (speed**2 + 0.3**2)
        quality = self.config.quality * np.exp(0.25 * walk) * (0.02 + 0.98 * moving)
        return np.where(self._in_dropout(first, count), 0.1 * quality, quality)

    def _in_dropout(self, first: int, count: int) -> NDArray[np.bool_]:
        """Tell which samples lie in dropouts; these begin and end within a block of samples."""
        inside = np.zeros(count, np.bool_)
        seconds = BLOCK / self.config.rate_hz
        for block in range(first // BLOCK, -(-(first + count) // BLOCK)):
            rng = np.random.default_rng([self.seed, LDV_DROPOUT_STREAM, block])
            for _ in range(rng.poisson(self.config.dropouts_per_hour / 3600.0 * seconds)):
                begin = block * BLOCK + int(rng.integers(BLOCK))
                length = round(rng.exponential(self.config.dropout) * self.config.rate_hz) + 1
                end = min(begin + length, (block + 1) * BLOCK)
                inside[max(begin - first, 0) : max(end - first, 0)] = True
        return inside

    def _drawn(self, stream: int, first: int, count: int, shape: tuple[int, ...]) -> FloatArray:
        """Return unit normal numbers ``first`` to ``first + count`` of a stream."""
        blocks = range(first // BLOCK, max(-(-(first + count) // BLOCK), first // BLOCK + 1))
        drawn = [
            np.random.default_rng([self.seed, stream, block]).standard_normal(shape)
            for block in blocks
        ]
        begin = first - blocks[0] * BLOCK
        return np.concatenate(drawn)[begin : begin + count]


def _each(matrix: FloatArray, vectors: FloatArray) -> FloatArray:
    """Multiply each of m vectors by a matrix; BLAS would round by how many they are."""
    return np.einsum("ij,mj->mi", matrix, vectors)


def ground_velocity(kinematics: Kinematics, lever_arm_b: FloatArray) -> FloatArray:
    """Return the velocity over the ground of a point of the body, body axes (m, 3) [m/s].

    ``C_b_enu v + omega x l``: the tangent frame stands still on the Earth, and so does the road.
    """
    C = kinematics.C_enu_b
    if C.ndim == 2:
        turned = _each(C.T, kinematics.velocity)
    else:
        turned = np.einsum("mji,mj->mi", C, kinematics.velocity)
    return turned + np.cross(kinematics.omega_b, lever_arm_b)
