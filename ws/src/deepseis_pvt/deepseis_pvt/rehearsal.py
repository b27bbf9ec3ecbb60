"""Positions' kernels compiled, or loaded, before the first sample (`deepseis_core.rehearsal`)."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from deepseis_core.gps_time import GpsTime
from deepseis_core.rehearsal import MONUMENT_ECEF, TOW_MS, WEEK, Receiver, ephemerides
from deepseis_core.types import MotionKind, MotionState, Observations
from deepseis_pvt.assisted_start import Assistance
from deepseis_pvt.observables import ObservablesConfig
from deepseis_pvt.phase_values import PhaseConfig
from deepseis_pvt.precise import PreciseConfig
from deepseis_pvt.precise_rtk import BaseConfig
from deepseis_pvt.precise_set import PrecisePositions, precise_positions
from deepseis_pvt.pvt_engine import PvtConfig, PvtEngine
from deepseis_pvt.rtk import RtkConfig
from deepseis_pvt.spp import SppConfig
from deepseis_pvt.still_reference import ReferenceConfig

BLOCKS: Final = 30
MOVES_AT: Final = 22
"""Blocks that are worked through, and the one at which motion begins."""


def rehearse(
    sample_rate_hz: float,
    observables: ObservablesConfig,
    precise: PreciseConfig,
    phase: PhaseConfig,
    reference: ReferenceConfig,
    spp: SppConfig,
    rtk: RtkConfig,
    base: BaseConfig,
) -> int:
    """Work through a moment of a made-up sky, once with transmit times and once without.

    Parameters
    ----------
    sample_rate_hz : float
        [Hz]
    observables, precise, phase, reference, spp, rtk, base
        Settings of the node.

    Returns
    -------
    int
        Positions found; none would mean that nothing was rehearsed.
    """
    spp = replace(spp, troposphere=False)
    positions = 0
    for decoded in (True, False):
        engine = _engine(sample_rate_hz, observables, spp)
        if not decoded:
            engine.push_klobuchar((0.0,) * 4, (0.0,) * 4)
        solver = precise_positions(
            MONUMENT_ECEF.tolist(), engine.book, sample_rate_hz, precise, phase, reference, spp,
            rtk, base,
        )  # fmt: skip
        receiver = Receiver(sample_rate_hz, transmit_time=decoded)
        for number in range(BLOCKS if decoded else 10):
            positions += _block(receiver, number, engine, solver)
    return positions


def _engine(sample_rate_hz: float, observables: ObservablesConfig, spp: SppConfig) -> PvtEngine:
    x, y, z = MONUMENT_ECEF.tolist()
    start_ns = GpsTime(WEEK, TOW_MS * 1_000_000).total_ns
    engine = PvtEngine(
        PvtConfig(),
        sample_rate_hz,
        [item.satellite for item in ephemerides()],
        observables=replace(observables, rate_hz=50),
        spp=spp,
        assistance=Assistance((x, y, z), start_ns),
    )
    for item in ephemerides():
        engine.push_ephemeris(item)
    return engine


def _block(receiver: Receiver, number: int, engine: PvtEngine, solver: PrecisePositions) -> int:
    first = number * receiver.block
    for epochs in receiver.epochs(number):
        engine.push_epochs(epochs)
    kind = MotionKind.MOVING if number >= MOVES_AT else MotionKind.STATIC
    nothing = np.zeros(6, np.float32)
    solver.push_motion(MotionState(first, first, int(kind), "rehearsal", nothing, nothing))
    found = engine.advance()
    for observations, _ in found:
        solver.push_base(_base(observations))
        solver.solve(observations)
    return engine.statistics["positions"] if number == BLOCKS - 1 else 0


def _base(observations: Observations) -> Observations:
    """Return what a base beside the antenna would have seen."""
    return replace(observations, sample_fraction=0.0)
