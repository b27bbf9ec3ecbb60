"""Rehearsals work through everything that the first samples would compile or load."""

from deepseis_core.imu_grades import grade_named
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.loose import LooseConfig
from deepseis_ins.motion_engine import MotionEngineConfig
from deepseis_ins.motion_state import MotionConfig
from deepseis_ins.rehearsal import rehearse_fusion, rehearse_motion
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


def rehearse_all() -> list[int]:
    """Do what the nodes do; returns what each found."""
    grade = grade_named("span-fsas")
    precise = PreciseConfig(wait_motion=True, add_discriminator=True)
    parts = PhaseConfig(), ReferenceConfig(), SppConfig(), RtkConfig(), BaseConfig()
    rehearse_decoding(2200)
    return [
        rehearse(4e6, ObservablesConfig(), precise, *parts),
        rehearse_fusion(FusionConfig(), LooseConfig(), grade, 4e6, 200.0),
        rehearse_motion(MotionEngineConfig(), MotionConfig(), grade, 200.0, 4e6),
        int(rehearse_search(AcquisitionConfig())),
    ]


def test_positions_aiding_decisions_and_a_detection_come_out_of_it():
    positions, running, said, detected = rehearse_all()
    assert positions >= 3
    assert running >= 20
    assert said >= 1
    assert detected == 1
