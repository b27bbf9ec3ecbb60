"""Rehearsals work through everything that the first samples would compile or load."""

import subprocess
import sys
from pathlib import Path

import pytest

from deepseis_core.imu_grades import grade_named
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.ldv_fusion import LdvFusionConfig
from deepseis_ins.loose import LooseConfig
from deepseis_ins.motion_engine import MotionEngineConfig
from deepseis_ins.motion_state import MotionConfig
from deepseis_ins.range_config import RangeConfig
from deepseis_ins.rehearsal import rehearse_fusion, rehearse_motion
from deepseis_ins.tight import TightConfig
from deepseis_pvt.observables import ObservablesConfig
from deepseis_pvt.phase_values import PhaseConfig
from deepseis_pvt.precise import PreciseConfig
from deepseis_pvt.precise_rtk import BaseConfig
from deepseis_pvt.rehearsal import rehearse
from deepseis_pvt.rtk import RtkConfig
from deepseis_pvt.spp import SppConfig
from deepseis_pvt.still_reference import ReferenceConfig
from deepseis_tracking.acquisition import AcquisitionConfig
from deepseis_tracking.rehearsal import rehearse_decoding, rehearse_search

COUPLED = {
    "loose": LooseConfig(),
    "tight": TightConfig(),
    "ranges": RangeConfig(),
    "ldv": LdvFusionConfig(),
}


def rehearse_all() -> list[int]:
    """Do what the nodes do; returns what each found."""
    grade = grade_named("span-fsas")
    precise = PreciseConfig(wait_motion=True, add_discriminator=True)
    parts = PhaseConfig(), ReferenceConfig(), SppConfig(), RtkConfig(), BaseConfig()
    rehearse_decoding(2200)
    return [
        rehearse(4e6, ObservablesConfig(), precise, *parts),
        rehearse_fusion(FusionConfig(), grade, 4e6, 200.0, **COUPLED),
        rehearse_motion(MotionEngineConfig(), MotionConfig(), grade, 200.0, 4e6),
        int(rehearse_search(AcquisitionConfig())),
    ]


def test_positions_aiding_decisions_and_a_detection_come_out_of_it():
    positions, running, said, detected = rehearse_all()
    assert positions >= 3
    assert running >= 20
    assert said >= 1
    assert detected == 1


@pytest.mark.parametrize("coupling", ["loose", "tight", "ldv"])
def test_a_coupling_rehearses_all_kernels_that_a_run_takes(coupling):
    """In a process of its own: other tests have loaded them here."""
    script = Path(__file__).parents[1] / "rehearsed_kernels.py"
    done = subprocess.run([sys.executable, script, coupling], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    running, run, *new = done.stdout.split()
    assert int(running) >= 20
    assert int(run) >= 100
    assert new == []
