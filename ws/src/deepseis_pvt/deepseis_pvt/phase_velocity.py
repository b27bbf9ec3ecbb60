"""How far an antenna moves between two epochs, by the carrier phases alone.

Of a satellite that both epochs hold without a slip, the phase grows by the range and by the
clock; ambiguities cancel. The single-point solutions at both epochs give the range's greater part
with all models, their errors ``x`` remain::

    d(lambda L) - d(P - residual) = d(e . x) + d(clock)

solved for ``dx`` by least squares, the line of sight ``e`` that of the later epoch. Good to
millimetres in a second, a hundred times better than codes. What the direction to the satellite
turns meanwhile (1.5e-4 rad/s) makes 0.3 mm/s of two metres of position error, but changes slowly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_core.constants import L1_WAVELENGTH
from deepseis_core.types import FloatArray, Lli, Observations
from deepseis_pvt.spp import SppSolution

PHASE_SD: Final = 0.003
"""Of a difference of phases in the zenith, multipath and atmosphere included [m]."""
LARGEST: Final = 5.0
"""Of a residual over its sigma: beyond it there was a slip."""


@dataclass(frozen=True)
class PhaseEpoch:
    """What an epoch leaves for the next: per satellite phase and modelled range [m]."""

    satellites: tuple[str, ...]
    phase: FloatArray
    modelled: FloatArray
    unit: FloatArray
    elevation: FloatArray
    slipped: frozenset[str]
    position_ecef: FloatArray


def phase_epoch(
    observations: Observations,
    chosen: Sequence[int],
    satellite_position: FloatArray,
    solution: SppSolution,
) -> PhaseEpoch:
    """Keep what is needed of an epoch.

    Parameters
    ----------
    observations : Observations
    chosen : sequence of int
        Its satellites that were given to the solver.
    satellite_position : ndarray, shape (n, 3)
        Theirs, ECEF [m].
    solution : SppSolution
    """
    rows = np.asarray(chosen, np.int64)[solution.used]
    away = satellite_position[solution.used] - solution.position_ecef
    names = observations.satellites
    slip = int(Lli.SLIP)
    return PhaseEpoch(
        satellites=tuple(names[k] for k in rows),
        phase=L1_WAVELENGTH * observations.carrier_phase_cycles[rows],
        modelled=observations.pseudorange[rows] - solution.pseudorange_residual[solution.used],
        unit=away / np.linalg.norm(away, axis=1)[:, None],
        elevation=solution.elevation[solution.used],
        slipped=frozenset(names[k] for k in rows if int(observations.lli[k]) & slip),
        position_ecef=solution.position_ecef,
    )


def phase_step(before: PhaseEpoch, after: PhaseEpoch) -> tuple[FloatArray, FloatArray] | None:
    """Return the displacement between two epochs and its covariance, ECEF (3,), (3, 3) [m].

    None where fewer than four satellites kept their phase.
    """
    pairs = [
        (before.satellites.index(name), k)
        for k, name in enumerate(after.satellites)
        if name in before.satellites and name not in after.slipped
    ]
    while len(pairs) >= 4:
        old, new = np.array(pairs).T
        value = after.phase[new] - before.phase[old]
        value = value - (after.modelled[new] - before.modelled[old])
        design = np.column_stack([-after.unit[new], np.ones(len(pairs))])
        weight = np.maximum(np.sin(after.elevation[new]), 0.05) / PHASE_SD
        scaled = design * weight[:, None]
        normal = scaled.T @ scaled
        if not np.linalg.cond(normal) < 1e10:
            return None
        inverse = np.linalg.inv(normal)
        x = inverse @ (scaled.T @ (value * weight))
        left = np.abs(value - design @ x) * weight
        worst = int(np.argmax(left))
        if len(pairs) == 4 or left[worst] < LARGEST:
            step = after.position_ecef - before.position_ecef + x[:3]
            return step, inverse[:3, :3]
        del pairs[worst]
    return None
