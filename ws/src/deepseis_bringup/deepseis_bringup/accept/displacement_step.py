"""A real coseismic step: held by the fused station, lost by an accelerometer alone.

K-NET MYG004 with the displacement of GEONET 0915, 5 km away (scenario ``coseismic``). Beside the
station's streams stands what an accelerometer at the same place gives: the mean before the
event taken off, integrated twice.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from deepseis_bringup.accept.displacement_figures import step_figures
from deepseis_bringup.accept.displacement_streams import BASED, FUSED, PHASES, RTK, Stream, shake
from deepseis_bringup.accept.scene import RATE_HZ, Scene, Work, aided
from deepseis_bringup.accept.tables import Goal, Row
from deepseis_core.rotation import matrix_from_quat
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import FloatArray
from deepseis_frontend.if_bag import IfBag
from deepseis_frontend.imu_open import open_imu

TABLE: Final = "Coseismic step, MYG004 with GEONET 0915"
INTEGRATED: Final = "accelerometer integrated twice"
AXES: Final = ("east", "north", "up")
GRADES: Final = ("span-fsas", "mti-g")
HELD: Final = 10.0
"""Goal: the step to so much [mm]."""
AFTER_S: Final = 1.0
"""Rest after the motion that is left out: it may not be known to be rest yet [s]."""


def coseismic_step(work: Work) -> None:
    """Give the table and pictures of every grade of IMU."""
    for grade in GRADES:
        work.say(f"coseismic: simulating with {grade}")
        settings = [f"imu.grade={grade}"]
        scene = Scene(
            "coseismic", work.folder, short=work.short, settings=settings, label=grade, base=True
        )
        if scene.stands_in:
            work.acceptance.remarks.append("coseismic: an artificial motion and a step stand in.")
        shaken = shake(scene, (aided(8.0, grade),), work.say)
        streams = {**shaken.runs[0].streams, INTEGRATED: integrated_twice(scene)}
        end = scene.moving[1] + 2.0 * (scene.scenario.duration - scene.moving[1]) / 3.0
        after = scene.moving[1] + AFTER_S + 1.5, scene.scenario.duration
        whole = scene.moving[0], scene.scenario.duration
        step = shaken.truth(np.array([end]))[0]
        work.acceptance.add(*_truth_rows(grade, step))
        for name, stream in streams.items():
            error = _errors(stream, shaken.truth, scene.still)
            work.acceptance.add(*_rows(f"{grade}, {name}", error, after, whole, name))
        work.acceptance.figures.append(
            (TABLE, step_figures(f"coseismic, {grade}", streams, shaken.truth, scene.still,
                                 scene.scenario.duration, INTEGRATED))
        )  # fmt: skip


def integrated_twice(scene: Scene) -> Stream:
    """Return what an accelerometer alone gives: no gyroscopes, its mean at rest taken off."""
    clock = SampleClock(IfBag(scene.bag).start_utc_ns or 0, RATE_HZ)
    recording = open_imu(scene.bag, clock)
    samples = list(recording.samples())
    t = np.array([item.sample_index for item in samples]) / RATE_HZ
    force = np.array([item.linear_acceleration for item in samples])
    orientation = scene.inertial()["fusion"]["imu_orientation_xyzw"]
    acceleration = force @ matrix_from_quat(np.array(orientation)).T
    before = t < scene.still[1]
    acceleration -= acceleration[before].mean(axis=0)
    acceleration[before] = 0.0  # who integrates a record begins at its onset
    step = 1.0 / recording.rate_hz
    # Each sample is the mean over the interval before it: sums are velocities at interval ends.
    velocity = step * np.cumsum(acceleration, axis=0)
    middle = velocity - 0.5 * step * acceleration
    return Stream(t, step * np.cumsum(middle, axis=0))


def _errors(stream: Stream, truth: object, still: tuple[float, float]) -> Stream:
    error = stream.moved - truth(stream.t)  # type: ignore[operator]
    rest = (stream.t >= still[0]) & (stream.t < still[1])
    return Stream(stream.t, error - error[rest].mean(axis=0))


def _truth_rows(grade: str, step: FloatArray) -> list[Row]:
    return [
        Row(TABLE, f"{grade}, truth", f"step {axis}", "mm", 1e3 * float(value))
        for axis, value in zip(AXES, step, strict=True)
    ]


def _rows(
    where: str, error: Stream, after: tuple[float, float], whole: tuple[float, float], name: str
) -> list[Row]:
    left = 1e3 * error.between(*after).moved
    shaking = 1e3 * np.linalg.norm(error.between(*whole).moved, axis=1)
    bound = Goal.at_most(HELD) if name in (FUSED, BASED, PHASES, RTK) else None
    printed = "metres" if name == INTEGRATED else None
    missing = not len(left)
    off = float("nan") if missing else float(np.linalg.norm(left.mean(axis=0)))
    greatest = float("nan") if missing else float(shaking.max())
    return [
        Row(TABLE, where, "step off by, in space", "mm", off, printed, bound),
        Row(TABLE, where, "greatest error, in space", "mm", greatest, None,
            Goal.at_most(HELD) if name in (FUSED, BASED) else None),
    ]  # fmt: skip
