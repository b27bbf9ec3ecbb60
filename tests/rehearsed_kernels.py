"""Which kernels a fusion loads after its rehearsal; run in a process of its own.

Prints rehearsed spans with aiding, spans of the run, and the kernels that only the run loaded.
"""

import sys

from fusion_bench import FusionBench, precise_positions
from numba.core.dispatcher import Dispatcher

from deepseis_core.ros import codecs
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.ldv_fusion import LdvFusionConfig
from deepseis_ins.loose import LooseConfig
from deepseis_ins.range_config import RangeConfig
from deepseis_ins.rehearsal import rehearse_fusion
from deepseis_ins.tight import TightConfig

STATION = (
    "sine-2hz", "span-fsas", "duration=8", "motion.0.radius=0.12", "motion.0.frequency_hz=2.0",
    "motion.0.start=5", "motion.0.duration=3",
)  # fmt: skip
VEHICLE = "gravity-lines", "navigation", "duration=12", "motion.0.start=8", "motion.0.length=800"


def loaded() -> dict[str, int]:
    """Return how many forms of each kernel are there."""
    kernels = {
        id(value): value
        for name, module in sys.modules.items()
        if name.startswith("deepseis")
        for value in vars(module).values()
        if isinstance(value, Dispatcher)
    }
    return {k.py_func.__qualname__: len(k.nopython_signatures) for k in kernels.values()}


def received(codec, values):
    """Return what arrives of values that are sent."""
    return [codec.decode(codec.encode(value, 0))[0] for value in values]


def main(coupling: str) -> None:
    bench = FusionBench(*(VEHICLE if coupling == "ldv" else STATION))
    inputs, ldv = bench.inputs, LdvFusionConfig(ldv_lever_arm=[0.05, -0.05, -0.5])
    given = {
        "pvt": received(codecs.PVT, inputs.pvt),
        "motion": received(codecs.MOTION_STATE, inputs.motion),
        "precise": received(codecs.PRECISE_POSITION, precise_positions(bench)),
    }
    if coupling == "tight":
        given["observations"] = received(codecs.OBSERVATIONS, inputs.observations)
    if coupling == "ldv":
        given["ldv"] = received(codecs.LDV_VELOCITY, inputs.ldv)
    bench.ephemerides = received(codecs.EPHEMERIS, bench.ephemerides)
    config = FusionConfig(coupling=coupling)
    running = rehearse_fusion(
        config, bench.grade, bench.sample_rate_hz, bench.imu_rate_hz,
        loose=LooseConfig(), tight=TightConfig(), ranges=RangeConfig(), ldv=ldv,
    )  # fmt: skip
    before = loaded()
    engine = bench.engine(config, **({"ldv_config": ldv} if coupling == "ldv" else {}), **given)
    spans = len(bench.run(engine).spans)
    new = [name for name, count in loaded().items() if count > before.get(name, 0)]
    print(running, spans, *new)


if __name__ == "__main__":
    main(sys.argv[1])
