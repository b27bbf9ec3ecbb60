"""A stream's error is split into its lag and what is left."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from deepseis_bringup.accept import displacement_streams
from deepseis_bringup.accept.displacement_streams import (
    BASED,
    FUSED,
    Listener,
    Stream,
    compare,
    shake,
)
from deepseis_bringup.accept.scene import Loop, aided, conventional
from deepseis_bringup.offline import Output
from deepseis_core.types import Displacement, DisplacementSource, FloatArray

STILL, MOVING = (0.0, 5.0), (6.0, 26.0)


def truth(t: FloatArray) -> FloatArray:
    """Return a circle of 12 cm at 2 Hz from 5 s on."""
    angle = 4.0 * np.pi * (t - 5.0)
    moves = (t > 5.0) * np.clip(t - 5.0, 0.0, 1.0)
    flat = [np.sin(angle), np.cos(angle), 0.0 * t]
    return np.asarray(0.12 * moves[:, None] * np.stack(flat, axis=1))


@pytest.mark.parametrize("lag", [-0.004, 0.0, 0.0123, 0.0565])
def test_a_lag_is_found_and_noise_left(lag: float) -> None:
    t = np.arange(0.0, 30.0, 0.02)
    noise = np.random.default_rng(4).normal(0.0, 1e-3, (len(t), 3))
    surveyed_off = np.array([0.02, -0.01, 0.05])
    stream = Stream(t, truth(t - lag) + noise + surveyed_off)
    found = compare(stream, truth, STILL, MOVING)
    # 1000 epochs of 1 mm on each axis against 1.5 m/s: 1e-3 / (1.5 sqrt(1000)) = 21 us.
    assert found.lag == pytest.approx(lag, abs=1e-4)
    assert found.left == pytest.approx(np.sqrt(2.0) * 1e-3, rel=0.05)
    moved = 2.0 * 0.12 * abs(np.sin(2.0 * np.pi * lag))
    assert np.hypot(*found.rms[:2]) == pytest.approx(np.hypot(moved, np.sqrt(2) * 1e-3), rel=0.05)


def test_a_gain_is_no_lag() -> None:
    t = np.arange(0.0, 30.0, 0.02)
    found = compare(Stream(t, 1.05 * truth(t)), truth, STILL, MOVING)
    assert found.lag == pytest.approx(0.0, abs=1e-4)
    assert found.left == pytest.approx(0.05 * 0.12, rel=0.02)


def test_what_never_came_is_no_number() -> None:
    t = np.arange(0.0, 4.0, 0.02)
    assert np.isnan(compare(Stream(t, truth(t)), truth, STILL, MOVING).left)


class _Scene:
    """Remembers with which loops it was run."""

    name = "made up"
    scenario = SimpleNamespace(start=SimpleNamespace(time=SimpleNamespace(tow_ns=0)))

    def __init__(self, base: bool) -> None:
        self.base = base
        self.ran: list[tuple[Loop, Loop | None]] = []

    def run(self, loop: Loop, listen: Listener, beside: Loop | None) -> None:
        self.ran.append((loop, beside))
        for topic in ("seismo/displacement", "beside/seismo/displacement"):
            listen(Output(topic, moved(0.001 * len(topic)), 0))


def moved(east: float) -> Displacement:
    row = np.array([[east, 0.0, 0.0]])
    sd = np.zeros((1, 3), np.float32)
    return Displacement(
        source=int(DisplacementSource.FUSED), smoothed=False, valid_through=0, interval=0.005,
        tow_ns=np.array([10**9]), week=2399, displacement=row, velocity=row, acceleration=row,
        displacement_sd=sd, velocity_sd=sd, acceleration_sd=sd,
    )  # fmt: skip


def test_what_is_said_of_a_station_alone_is_not_from_its_base(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(displacement_streams, "truth_of", lambda _scene: truth)
    scene = _Scene(base=True)
    loops = aided(8.0), conventional(15.0)
    run, _ = shake(scene, loops, lambda _text: None).runs  # type: ignore[arg-type]
    (alone, beside), (unaided, nobody) = scene.ran
    # The base is in the recording and RTK is solved; the loops' fusion does not follow it.
    assert alone.fusion["rtk"] is False
    assert beside is not None
    assert beside.fusion.get("rtk", True)
    assert unaided == loops[1]
    assert nobody is None
    assert run.streams[FUSED].moved[0, 0] == pytest.approx(0.019)
    assert run.streams[BASED].moved[0, 0] == pytest.approx(0.026)
    without = _Scene(base=False)
    shake(without, loops[:1], lambda _text: None)  # type: ignore[arg-type]
    assert without.ran[0][1] is None
