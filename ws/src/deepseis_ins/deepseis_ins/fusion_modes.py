"""Which engine a coupling has."""

from __future__ import annotations

from typing import Any

from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.fusion_engine import FusionEngine
from deepseis_ins.ldv_engine import LdvFusionEngine
from deepseis_ins.ldv_fusion import LdvFusionConfig
from deepseis_ins.range_config import RangeConfig
from deepseis_ins.tight import TightConfig
from deepseis_ins.tight_engine import TightFusionEngine


def make_engine(
    config: FusionConfig,
    *given: Any,
    tight: TightConfig,
    ranges: RangeConfig,
    ldv: LdvFusionConfig,
    **more: Any,
) -> FusionEngine:
    """Make the engine of ``config.coupling``; arguments are those of `FusionEngine`."""
    if config.coupling == "tight":
        return TightFusionEngine(config, *given, tight=tight, ranges=ranges, **more)
    if config.coupling == "ldv":
        return LdvFusionEngine(config, *given, ldv=ldv, **more)
    return FusionEngine(config, *given, **more)
