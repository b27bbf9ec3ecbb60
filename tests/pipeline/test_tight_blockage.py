"""30 s of shaking under three and two satellites, from samples to position, loose and tight."""

from dataclasses import replace

import numpy as np
import pytest

from deepseis_bringup.accept.loop_measures import thermal_deg
from deepseis_bringup.accept.scene import RATE_HZ, Scene, aided
from deepseis_core.types import PvtStatus
from deepseis_sim import scenario as scenarios
from deepseis_sim.motions import Circle
from deepseis_sim.sky import Obstruction, SkyConfig

pytestmark = pytest.mark.slow

ONSET, BLOCKED, LAST = 12.0, (16.0, 31.0, 46.0), 50.0
KEPT = (3, 2)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Seven satellites; 12 cm at 2 Hz from 12 s on; three from 16 s, two from 31 s to 46 s."""
    circle = Circle(radius=0.12, frequency_hz=2.0, start=ONSET, duration=36.0, ramp=0.5)
    base = scenarios.load_scenario("sine-2hz", short=True)
    spells = zip(KEPT, BLOCKED, BLOCKED[1:], strict=False)
    hidden = tuple(Obstruction(keep=n, from_s=a, to_s=b) for n, a, b in spells)
    sky = SkyConfig(satellites=7, obstructions=hidden)
    small = replace(base, duration=LAST, motion=(circle,), sky=sky)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deepseis_bringup.accept.scene.load_scenario", lambda *_, **__: small)
        made = Scene("sine-2hz", tmp_path_factory.mktemp("scene"), short=True)
    made.moving, made.still = (BLOCKED[0] + 1.0, BLOCKED[2] - 0.5), (8.6, ONSET - 0.1)
    return made


@pytest.fixture(scope="module")
def runs(scene):
    return {name: fly(scene, name) for name in ("loose", "tight")}


def fly(scene, coupling):
    """Return figures of the loops, and times, errors and sigmas of the position (ENU) [m]."""
    solutions, positions = [], []

    def listen(output):
        if output.topic == "ins/solution" and len(output.value.sample_index):
            solutions.append(output.value)
        elif output.topic == "gnss/pvt":
            positions.append(output.value)

    loop = replace(aided(8.0), fusion={"coupling": coupling})
    outcome = scene.run(loop, listen)
    sample = np.concatenate([s.sample_index for s in solutions])
    place = np.concatenate([s.position_enu for s in solutions])
    sd = np.concatenate([s.state_sd[:, [1, 0, 2]] for s in solutions])
    with np.load(scene.truth_file) as truth:
        bias = np.interp(sample / RATE_HZ, truth["t_s"], truth["clock_bias"])
    t = sample / RATE_HZ - bias
    circle = scene.scenario.motion[0].at(t).position
    for pvt in positions:
        # A second without signal until a loop gives up, and what C/N0 takes to fall.
        if BLOCKED[0] + 3.0 < pvt.sample_index / RATE_HZ < BLOCKED[2]:
            assert pvt.status == PvtStatus.NONE
    return outcome, t, place - place[0] - circle, sd


def test_position_through_the_blockage(runs):
    """Ranges hold what the IMU alone lets go, and both err as they say."""
    for name, (_, t, error, sd) in runs.items():
        ends = [int(np.searchsorted(t, b - 0.1)) for b in BLOCKED[1:]]
        for end, what in zip(ends, KEPT, strict=True):
            off = error[end]
            print(f"{name}: {what} satellites, off by {off.round(3)} m, says {sd[end].round(3)} m")
            assert np.all(np.abs(off) < 4.0 * sd[end])
    end = int(np.searchsorted(runs["tight"][1], BLOCKED[2] - 0.1))
    assert np.linalg.norm(runs["tight"][3][end]) < np.linalg.norm(runs["loose"][3][end])


def test_the_satellites_that_are_left_are_held(runs):
    """Two satellites stay all the time: no slip, thermal noise, aided through 30 s without PVT."""
    outcome, *_ = runs["tight"]
    held = [item for item in outcome.moving if item.locked > 0.99]
    assert len(held) >= KEPT[-1]
    assert not any(item.slips for item in held)
    ratios = [item.own_rms / thermal_deg(8.0, item.cn0_dbhz) for item in held]
    # 900 independent errors: 2.4 % of sampling.
    assert np.sqrt(np.mean(np.square(ratios))) < 1.10
