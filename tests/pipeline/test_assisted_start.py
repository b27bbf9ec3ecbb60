"""A station that knows where it is needs no subframe: position, coarse time, ephemeris."""

import numpy as np

from deepseis_bringup.graph import GraphConfig
from deepseis_bringup.offline import OfflineChain
from deepseis_core.geodesy import ecef_from_geodetic, enu_from_ecef

STATION = ecef_from_geodetic(np.array([np.radians(35.681298), np.radians(139.766247), 10.0]))
VISIBLE = {"G10", "G12", "G13", "G15", "G18", "G19", "G23", "G24", "G25", "G32"}


def test_first_fix_within_three_seconds_and_only_visible_satellites_searched(shared_data):
    folder = shared_data / "if_captures" / "independent_sim"
    known = {"nav_file": str(folder / "brdc0010.22n"), "position_ecef": STATION.tolist()}
    source = {
        "file": str(folder / "circle_12cm_2hz_30s_4MHz_1bit_iq.bin"),
        "format": "independent_sim",
        "sample_rate_hz": 4e6,
        "start_utc": "2022-01-01T02:00:40",  # coarse: 28 s late
        "length_s": 7.0,
    }
    parameters = {"pvt": {**known, "troposphere": False}, "acquisition": known}
    chain = OfflineChain(GraphConfig(source=source, sample_rate_hz=4e6, parameters=parameters))
    searched, fixes = set(), []
    for output in chain.run():
        if output.topic == "acquisition/result":
            searched.add(output.value.satellite)
        if output.topic == "gnss/pvt":
            fixes.append((output.value.sample_index / 4e6, output.value))
    assert searched == VISIBLE
    assert fixes[0][0] < 3.0
    late = np.array([pvt.position_ecef for second, pvt in fixes if second > 5.0])
    east, north, up = np.abs(enu_from_ecef(late, STATION).mean(axis=0))
    # Still until 10 s. Code noise 0.5-2 m a satellite at 34-44 dB-Hz, correlated over a second.
    assert max(east, north) < 3.0
    assert up < 6.0
    # Time is right to the millisecond: 02:00:30 GPST plus the time since the first sample.
    second, pvt = fixes[-1]
    assert abs(pvt.tow_ns * 1e-9 - (525_630.0 + second)) < 1e-3
