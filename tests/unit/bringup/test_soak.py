"""The soak test's own parts: what it plans, what it measures, and that it can fail."""

from __future__ import annotations

import os
import tempfile
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest

from deepseis_bringup.accept.tables import Acceptance
from deepseis_bringup.restarts import RestartConfig, Restarts
from deepseis_bringup.soak.observables import Holes, renewed, soak_observables
from deepseis_bringup.soak.plan import FIRST_S, LAST_S, LENGTHS, Disturbance, plan
from deepseis_bringup.soak.report import (
    add_losses,
    add_resources,
    losses,
    losses_of_holes,
)
from deepseis_bringup.soak.resources import Resources, growth_of
from deepseis_bringup.soak.signal import Reaper
from deepseis_core.ephemeris import pack, satellite_states
from deepseis_core.gps_time import GpsTime
from deepseis_sim.nominal_constellation import nominal_constellation

VICTIMS = ("fusion", "trackers", "pvt")


def test_disturbances_follow_each_other_all_kinds_alike() -> None:
    found = plan(3600.0, 3, victims=VICTIMS, satellites=9)
    counts = Counter(item.kind for item in found)
    assert set(counts) == set(LENGTHS)
    assert max(counts.values()) - min(counts.values()) <= 1
    deaths = Counter(item.victim for item in found if item.kind == "kill")
    assert max(deaths.values()) - min(deaths.values()) <= 1
    ends = [item.end for item in found]
    gaps = np.array([b.begin for b in found[1:]]) - ends[:-1]
    # 20 s in the mean, 0.6 to 1.4 of it, on a grid of 20 ms.
    assert 11.9 < gaps.min() < gaps.max() < 28.1
    assert np.mean(gaps) == pytest.approx(20.0, rel=0.1)
    assert found[0].begin >= FIRST_S
    assert ends[-1] <= 3600.0 - LAST_S
    assert plan(3600.0, 4, victims=VICTIMS) != found


@pytest.mark.parametrize(("slope", "flat"), [(0.0, True), (40.0, False)])
def test_a_leak_is_found_in_the_noise_of_an_allocator(slope: float, flat: bool) -> None:
    random = np.random.default_rng(1)
    t = np.arange(0.0, 1800.0, 5.0)
    memory = 200.0 + slope * t / 3600.0 + 3.0 * (random.random(t.size) > 0.5)
    resources = Resources({("node", 7): [(x, y, 20.0) for x, y in zip(t, memory, strict=True)]})
    acceptance = Acceptance("soak", "")
    add_resources(acceptance, "memory", resources)
    (row,) = (row for row in acceptance.rows if row.quantity == "slope and two sigmas")
    assert row.met is flat
    assert growth_of("x", resources.table("node")).slope_mb_per_h == pytest.approx(slope, abs=6.0)


def test_file_handles_that_stay_open_are_found() -> None:
    held, resources = [], Resources()
    for k in range(60):
        held.append(tempfile.TemporaryFile())  # noqa: SIM115 (they are to stay open)
        resources.sample(float(k), {"self": os.getpid()})
    (found,) = resources.growth()
    assert found.last_handles - found.first_handles > 10
    for file in held:
        file.close()


def test_what_is_lost_beyond_a_gap_is_charged_to_it() -> None:
    t = np.arange(0.0, 100.0, 0.02)
    good = ~((t >= 50.0) & (t < 53.5))
    timelines = {"aiding": (t, good), "position": (t, np.ones(t.size, np.bool_))}
    hit = [Disturbance("imu-gap", 50.0, 1.0), Disturbance("imu-gap", 80.0, 1.0)]
    found = losses(hit, timelines, 100.0)["imu-gap"]
    assert [pair[1] for pair in found["aiding"]] == pytest.approx([2.5, 0.0], abs=0.03)
    assert [pair[0] for pair in found["position"]] == [0.0, 0.0]
    acceptance = Acceptance("soak", "")
    add_losses(acceptance, "lost", {"imu-gap": found})
    assert acceptance.counts() == (1, 2)
    holes = Holes(0.02)
    for at, there in zip(t, good, strict=True):
        if there:
            holes.add(float(at))
    of_holes = losses_of_holes(hit, {"aiding": holes}, 100.0)["imu-gap"]["aiding"]
    assert [pair[1] for pair in of_holes] == pytest.approx([2.5, 0.0], abs=0.03)


def test_the_second_death_of_a_node_lasts_until_it_is_back_again() -> None:
    """Not until the next look: it has come back before."""
    now, process = 0.0, SimpleNamespace(kill=lambda: None)
    restarts = Restarts(RestartConfig(backoff_s=(0.0,)), clock=lambda: now)
    nodes = SimpleNamespace(processes={"pvt": process})
    reaper = Reaper(nodes, restarts, [Disturbance("kill", at, 0.0, "pvt") for at in (5.0, 50.0)])
    noticed, started, back = 0.1, 0.2, 2.0
    for step in range(1000):
        now = 0.1 * step
        reaper.poll(now)
        for death in (5.0, 50.0):
            if abs(now - death - noticed) < 0.05:
                restarts.died("pvt", "was killed by signal 9")
            elif abs(now - death - started) < 0.05:
                restarts.due()
            elif abs(now - death - back) < 0.05:
                restarts.joined("pvt")
    assert [item.begin for item in reaper.done()] == pytest.approx([5.0, 50.0])
    assert [item.length for item in reaper.done()] == pytest.approx([2.0, 2.0], abs=0.11)


def test_a_renewed_broadcast_is_the_same_orbit_and_clock() -> None:
    start = GpsTime(2400, 86_400 * 10**9)
    for orbit in nominal_constellation(start, seed=1)[:8]:
        new = renewed(orbit, orbit.toe + 7200.0)
        assert new.toe == orbit.toe + 7200.0
        for late in (0, 3600, 9000):
            tow_ns = round((orbit.toe + late) * 1e9)
            old, now = (
                satellite_states(pack([item]), orbit.week, tow_ns, np.zeros(1))[0]
                for item in (orbit, new)
            )
            # Angles of 1e4 rad at 2.7e7 m, to 53 bits.
            assert np.abs(old - now).max() < 1e-4


@pytest.mark.slow
def test_a_quarter_of_an_hour_of_observables() -> None:
    run = soak_observables(0.25, rate_hz=5.0, every_s=40.0)
    assert run.epochs == pytest.approx(0.25 * 3600 * 5, abs=2)
    assert run.events == 3
    assert len(run.disturbances) > 10
    found = losses_of_holes(run.disturbances, run.holes, 900.0)
    for kind, streams in found.items():
        for stream, values in streams.items():
            if stream in ("position", "fused displacement"):
                assert max(beyond for _, beyond in values) <= 1.0, (kind, stream, values)
    # Not a frozen stream: the outages were there.
    assert sum(seconds for seconds, _ in found["no-signal"]["position"]) > 1.0
