"""Kernels of fusion and motion compiled, or loaded, before the first sample.

See `deepseis_core.rehearsal`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from deepseis_core.geodesy import normal_gravity
from deepseis_core.imu_grades import ImuGrade
from deepseis_core.rehearsal import BLOCK_S, MONUMENT_ECEF, WEEK, Receiver, ephemerides
from deepseis_core.types import (
    ImuSample,
    LdvVelocity,
    MotionKind,
    MotionState,
    PrecisePosition,
    PreciseStatus,
    Pvt,
    PvtStatus,
    Station,
)
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.fusion_engine import FusionEngine
from deepseis_ins.fusion_modes import make_engine
from deepseis_ins.fusion_output import FusionOutput, FusionStatus
from deepseis_ins.ldv_engine import LdvFusionEngine
from deepseis_ins.motion_engine import MotionEngine, MotionEngineConfig
from deepseis_ins.motion_state import MotionConfig
from deepseis_ins.tight_engine import TightFusionEngine

ALIGNMENT_S: Final = 0.4
MOVES_AT: Final = 40
SPANS: Final = 60
"""Spans of 20 ms: the first that moves, and all of them."""
BEAM_ELEVATION: Final = np.radians([60.0, 45.0])
"""Of a velocimeter's beams [rad]."""


def rehearse_fusion(
    config: FusionConfig,
    grade: ImuGrade,
    sample_rate_hz: float,
    imu_rate_hz: float,
    **settings: Any,
) -> int:
    """Let a made-up station stand still and move, with what its coupling takes.

    Parameters
    ----------
    config : FusionConfig
    grade : ImuGrade
    sample_rate_hz, imu_rate_hz : float
        [Hz]
    settings
        ``loose``, ``tight``, ``ranges``, ``ldv``, as of `fusion_modes.make_engine`.

    Returns
    -------
    int
        Spans with valid aiding; none would mean that nothing was rehearsed.
    """
    config = replace(config, start_s=0.0, alignment_s=ALIGNMENT_S)
    engine = make_engine(config, grade, sample_rate_hz, _station(), imu_rate_hz, **settings)
    for item in ephemerides():
        engine.push_ephemeris(item)
    if isinstance(engine, TightFusionEngine):
        engine.push_klobuchar((0.0,) * 4, (0.0,) * 4)
    samples = _imu(sample_rate_hz, imu_rate_hz)
    receiver, running = Receiver(sample_rate_hz), 0
    for number in range(SPANS):
        through = (number + 1) * receiver.block
        while samples and samples[0].sample_index <= through:
            engine.push_imu(samples.pop(0))
        _push_positions(engine, receiver, number)
        _push_coupled(engine, receiver, number)
        engine.push_motion(_motion(number, receiver))
        output = _advance(engine, through)
        running += output is not None and output.status is FusionStatus.RUNNING
    return running


def rehearse_motion(
    engine: MotionEngineConfig,
    detector: MotionConfig,
    grade: ImuGrade,
    imu_rate_hz: float,
    sample_rate_hz: float,
) -> int:
    """Let the detector look at a made-up station; returns how often it has said something."""
    made = MotionEngine(engine, detector, grade, imu_rate_hz, sample_rate_hz)
    samples = _imu(sample_rate_hz, imu_rate_hz)
    for sample in samples:
        made.push(sample)
    return sum(len(said) for _, said in made.advance(samples[-1].sample_index))


def _advance(engine: FusionEngine, through: int) -> FusionOutput | None:
    """Say that all inputs are there, and go a span further."""
    for valid in (engine.source_valid, engine.imu_valid, engine.motion_valid, engine.pvt_valid):
        valid(through)
    if isinstance(engine, LdvFusionEngine):
        engine.ldv_valid(through)
    return engine.advance()


def _station() -> Station:
    return Station(
        name="rehearsal",
        network="",
        monument_ecef=MONUMENT_ECEF,
        antenna_lever_arm=np.array([0.0, 0.0, 1.0]),
        imu_to_antenna=np.array([0.0, 0.0, 1.0]),
        imu_orientation_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
    )


def _imu(sample_rate_hz: float, imu_rate_hz: float) -> list[ImuSample]:
    """Return samples at rest, then shaken; a few are missing between."""
    count = round(SPANS * BLOCK_S * imu_rate_hz)
    moves, lost = MOVES_AT / SPANS * count, round(0.8 * count)
    random = np.random.default_rng(1)
    gravity = np.array([0.0, 0.0, float(normal_gravity(0.66, 50.0))])
    samples = []
    for number in range(1, count + 1):
        noise = random.normal(0.0, 1e-6, 3)
        shaken = np.array([0.5 * (number > moves) * (-1.0) ** number, 0.0, 0.0])
        if lost <= number < lost + 2:
            continue
        samples.append(
            ImuSample(
                int(number * sample_rate_hz / imu_rate_hz), noise, gravity + shaken, 1e-8, 1e-6
            )
        )
    return samples


def _motion(number: int, receiver: Receiver) -> MotionState:
    kind = MotionKind.MOVING if number >= MOVES_AT else MotionKind.STATIC
    sample, nothing = number * receiver.block, np.zeros(6, np.float32)
    return MotionState(sample, sample, int(kind), "rehearsal", nothing, nothing)


def _push_positions(engine: FusionEngine, receiver: Receiver, number: int) -> None:
    sample = number * receiver.block
    tow_ns, through = receiver.tow_ns(sample), sample + receiver.block - 1
    antenna = engine.site.antenna_ecef
    engine.push_precise(
        PrecisePosition(
            sample, WEEK, tow_ns, through, "rehearsal", PreciseStatus.PHASE, np.zeros(3),
            1e-6 * np.eye(3), 0.0, 1e-3,
        )
    )  # fmt: skip
    if number % 5 == 0:
        engine.push_pvt(
            Pvt(
                sample, WEEK, tow_ns, through, PvtStatus.SINGLE, antenna, np.zeros(3), 0.0, 0.0,
                np.eye(3), 1e-4 * np.eye(3),
            )
        )  # fmt: skip


def _push_coupled(engine: FusionEngine, receiver: Receiver, number: int) -> None:
    """Push what tight coupling, or a velocimeter, measures in a span."""
    if isinstance(engine, TightFusionEngine):
        engine.push_observations(receiver.observations(number))
    if isinstance(engine, LdvFusionEngine):
        sample, speed = number * receiver.block, 1.0 * (number >= MOVES_AT)
        beams = speed * np.cos(BEAM_ELEVATION)
        engine.push_ldv(
            LdvVelocity(
                sample, sample + receiver.block, beams, BEAM_ELEVATION, speed, 0.0,
                np.full(2, 1e-3, np.float32), 1e3,
            )
        )  # fmt: skip
