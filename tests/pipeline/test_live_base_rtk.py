"""A real base live over NTRIP: the solution is that of its file."""

import numpy as np
import pyrtklib as rtklib
import pytest
from base_caster import eventually, rtcm_of_rinex, rtklib_caster

from deepseis_core.gps_time import GpsTime
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import Observations, PreciseStatus
from deepseis_frontend.base_events import BaseReference
from deepseis_frontend.base_link import BaseLink
from deepseis_frontend.base_rtklib import rinex_events
from deepseis_frontend.ntrip import address_of
from deepseis_pvt.rtk import RtkConfig, RtkSolver
from deepseis_pvt.rtklib_values import BASE, ROVER, fill_observations, read_navigation

ANY = SampleClock(0, 4e6)


def over_ntrip(items, clock):
    """Return the events of a base that RTKLIB's caster serves."""
    events = []
    with rtklib_caster(items) as port:
        link = BaseLink(address_of(f"ntrip://me@127.0.0.1:{port}/MOUNT"), clock)

        def all_there():
            events.extend(link.take())
            return link.counts["epochs"] == len(items)

        eventually(all_there)
        link.close()
    return events


def solved(rover, events, navigation):
    """Return status and position of every epoch of the rover against a base's events."""
    nav = rtklib.nav_t()
    read_navigation(navigation, nav)
    (place,) = [e.position_ecef for e in events if isinstance(e, BaseReference)]
    epochs = [e for e in events if isinstance(e, Observations)]
    times = np.array([e.sample_index for e in epochs])
    solver, rows = RtkSolver(RtkConfig(rtk_mask_deg=15.0, rtk_code_ratio=100.0), place), []
    for mine in rover:
        count = fill_observations(mine, ROVER, solver.room, 0)
        before = int(np.searchsorted(times, mine.sample_index, side="right")) - 1
        if before < 0:
            continue
        theirs = epochs[before]
        found = solver.solve(count, fill_observations(theirs, BASE, solver.room, count), nav)
        rows.append((int(found.status), *found.position_ecef) if found else (0, *[np.nan] * 3))
    solver.close()
    return np.array(rows)


@pytest.mark.parametrize("kind", [1075, 1077])
@pytest.mark.parametrize(
    ("folder", "rover", "base", "navigation", "fixed"),
    [
        ("rtklib_geonet_3km_30s", "07590920.05o", "30400920.05o", "07590920.05n", 114),
        ("cssrlib_5km_1hz", "SEPT078M1.21O", "3034078M1.21O", "SEPT078M.21P", 60),
    ],
)
def test_the_solution_against_a_live_base_is_that_against_its_file(
    shared_data, folder, rover, base, navigation, fixed, kind
):
    home = shared_data / "rinex" / folder
    begin = next(e for e in rinex_events(home / base, ANY) if isinstance(e, Observations))
    clock = SampleClock(GpsTime(begin.week, begin.tow_ns).to_utc_ns(), 4e6)
    mine = [e for e in rinex_events(home / rover, clock) if isinstance(e, Observations)]
    live = over_ntrip(rtcm_of_rinex(home / base, kind), clock)
    file = list(rinex_events(home / base, clock))
    expected, got = (solved(mine, events, home / navigation) for events in (file, live))
    assert np.count_nonzero(expected[:, 0] == PreciseStatus.FIX) == fixed
    # One ratio of the first pair lies at its limit: phases are rounded to 0.5 or 0.14 mm.
    assert np.count_nonzero(got[:, 0] != expected[:, 0]) <= 1
    both = (got[:, 0] == PreciseStatus.FIX) & (expected[:, 0] == PreciseStatus.FIX)
    # Rounding has a sigma of 0.16 or 0.04 mm, which few satellites make several times larger.
    error = got[both, 1:] - expected[both, 1:]
    limit = 1e-3 if kind == 1075 else 3e-4
    assert np.sqrt(np.mean(error**2)) < limit
    assert np.abs(error).max() < 6 * limit
