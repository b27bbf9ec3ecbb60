"""A small earthquake played by the clock: what tests of nodes that die or stand still share."""

import os
from dataclasses import replace

import pytest

from deepseis_bringup.accept.scene import Scene
from deepseis_sim import scenario as scenarios
from deepseis_sim.motions import Circle
from deepseis_sim.sky import SkyConfig

BUSY = os.getloadavg()[0] > 2 * (os.cpu_count() or 1)
"""A process takes a second to start, and ten on a machine that has other work."""
ONSET = 6.5
"""Of the motion [s]."""


def make_scene(folder, length, *, base=False):
    """Nine satellites, so a fix after 1.4 s; 3 cm at 2 Hz: 0.5 g, which the loops bear alone."""
    circle = Circle(radius=0.03, frequency_hz=2.0, start=ONSET, duration=length, ramp=0.5)
    known = scenarios.load_scenario("sine-2hz", short=True)
    small = replace(known, duration=length, motion=(circle,), sky=SkyConfig(satellites=9))
    small = small if base else replace(small, base=None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deepseis_bringup.accept.scene.load_scenario", lambda *_, **__: small)
        return Scene("sine-2hz", folder, short=True)


def by_the_clock(config, folder, pace, **changes):
    """Play at a pace [s of samples a second], recorded in a folder, without the samples."""
    return replace(
        config,
        source={**config.source, "pace": pace},
        mode="realtime",
        record_dir=str(folder / "bag"),
        record_if=False,
        watched=True,
        **changes,
    )


def payloads_of(run):
    """Return what a run recorded by topic, without the leading stroke."""
    return {name.lstrip("/"): data for name, data in run.payloads().items()}
