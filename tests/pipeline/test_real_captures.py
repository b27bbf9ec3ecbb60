"""Signal from a real antenna through the chain: half a second is enough for phase lock."""

from deepseis_bringup.graph import GraphConfig
from deepseis_bringup.offline import OfflineChain
from deepseis_bringup.runs import SHORT_SETTINGS
from deepseis_core.types import TrackingFlag

LISTED = {"G26", "G31", "G16", "G29", "G32", "G18"}
BEYOND_THE_LIST = {"G03", "G04", "G25", "G27"}
"""Weaker, low satellites that are in the signal too (see test_acquisition_real_captures)."""


def test_the_half_second_capture_is_tracked_to_phase_lock(shared_data):
    source = {
        "file": str(shared_data / "if_captures/pocketsdr/L1_20211202_084700_4MHz_IQ.bin"),
        "format": "iq8 inverted",
        "sample_rate_hz": 4e6,
    }
    config = GraphConfig(source=source, sample_rate_hz=4e6, parameters=SHORT_SETTINGS)
    last, cn0 = {}, {}
    for output in OfflineChain(config).run():
        if output.topic.startswith("tracking/") and len(output.value.flags):
            last[output.value.satellite] = output.value.flags[-100:]
            cn0[output.value.satellite] = float(output.value.cn0_dbhz[-1])
    assert LISTED <= set(last) <= LISTED | BEYOND_THE_LIST
    wanted = TrackingFlag.CODE_LOCK | TrackingFlag.PHASE_LOCK
    for satellite in LISTED:
        assert (last[satellite] & wanted == wanted).all(), satellite
        assert not (last[satellite] & TrackingFlag.SLIP).any(), satellite
        assert 38.0 < cn0[satellite] < 52.0
