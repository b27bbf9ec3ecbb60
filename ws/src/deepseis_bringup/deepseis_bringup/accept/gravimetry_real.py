"""The Kingston drive through outages of GNSS: inertial navigation alone, and with its speed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from deepseis_bringup.accept.kingston import FOLDER, SPEED, Kingston, read_kingston
from deepseis_bringup.accept.tables import Goal, Row
from deepseis_bringup.report.plot import PALETTE, Figure, Panel, axis, line
from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.types import FloatArray
from deepseis_ins.ldv import LdvInstallation
from deepseis_ins.survey import Aids, Span, Survey
from deepseis_sim.scenario import data_folder

Say = Callable[[str], None]

OUTAGES: Final[tuple[Span, ...]] = tuple(
    (float(begin), float(begin) + 60.0) for begin in range(900, 3301, 200)
)
"""A minute every 200 s, from 6 min after the car's start, until then the filter learns [s]."""
LEAST_WAY: Final = 100.0
"""An outage at a red light tells nothing [m]."""
MOMENTS: Final = (10, 30, 60)
"""After the beginning of an outage [s]."""
TABLE: Final = "Kingston, outages of 60 s"


@dataclass(frozen=True)
class Growth:
    """Horizontal error after the beginning of k outages, shape (k, 61) [m], and ways [m]."""

    error: FloatArray
    way: FloatArray


def real_rows(say: Say) -> tuple[list[Row], list[Figure]]:
    """Return the lines and pictures of the real drive; none where it is not at hand."""
    folder = data_folder()
    if not (folder / FOLDER).is_dir():
        return [], []
    say("Kingston: outages, alone and with the speed")
    drive = read_kingston(folder)
    alone, aided = outage_growth(drive, with_speed=False), outage_growth(drive, with_speed=True)
    scenario = f"{len(alone.way)} outages, {np.median(alone.way):.0f} m each (median)"
    rows = []
    for second in MOMENTS:
        for name, growth in (("SINS alone", alone), ("SINS and speed", aided)):
            value = float(np.median(growth.error[:, second]))
            rows.append(
                Row(TABLE, scenario, f"{name}: error after {second} s, median", "m", value)
            )
    share = 100.0 * float(np.median(aided.error[:, -1] / aided.way))
    ratio = float(np.median(alone.error[:, -1]) / np.median(aided.error[:, -1]))
    rows += [
        Row(TABLE, scenario, "SINS and speed: error after 60 s, largest", "m",
            float(aided.error[:, -1].max())),
        Row(TABLE, scenario, "SINS and speed: error after 60 s over the way, median", "%", share),
        Row(TABLE, scenario, "gain of the speed after 60 s, ratio of medians", "-", ratio,
            goal=Goal.at_least(1.0)),
    ]  # fmt: skip
    return rows, [_figure(alone, aided)]


def outage_growth(drive: Kingston, *, with_speed: bool) -> Growth:
    """Navigate through all outages and compare with the reference.

    Alone it does not know when the car stands: that too is told by the speed.
    """
    imu = drive.imu if with_speed else replace(drive.imu, still=np.zeros_like(drive.imu.still))
    survey = Survey(imu, drive.speed if with_speed else None, drive.fixes, ldv_config=SPEED)
    edges = [-np.inf, *(edge for span in OUTAGES for edge in span), np.inf]
    covered = tuple(zip(edges[::2], edges[1::2], strict=True))
    installation = LdvInstallation.nominal(SPEED)
    track = survey.run(drive.filter(), installation, Aids(fixes=covered))
    place = ecef_from_geodetic(track.geodetic)
    errors, ways = [], []
    for begin, end in OUTAGES:
        time = np.arange(begin, end + 0.5, 1.0)
        way = np.diff(np.interp([begin, end], drive.reference_time, drive.reference_distance))[0]
        if way < LEAST_WAY:
            continue
        ours, theirs = (
            np.stack([np.interp(time, t, x[:, k]) for k in range(3)], axis=1)
            for t, x in ((track.time, place), (drive.reference_time, drive.reference_ecef))
        )
        apart = ours - theirs
        up = theirs / np.linalg.norm(theirs, axis=1)[:, None]
        flat = apart - np.sum(apart * up, axis=1)[:, None] * up
        errors.append(np.linalg.norm(flat, axis=1))
        ways.append(float(way))
    return Growth(np.array(errors), np.array(ways))


def _figure(alone: Growth, aided: Growth) -> Figure:
    time = np.arange(alone.error.shape[1], dtype=np.float64)
    data = []
    for k, (name, growth) in enumerate((("SINS alone", alone), ("SINS and speed", aided))):
        for row in growth.error:
            data.append(line(time, row, PALETTE[k], line={"width": 0.7}) | {"opacity": 0.5})
        middle = line(time, np.median(growth.error, axis=0), PALETTE[k], line={"width": 3})
        data.append(middle | {"name": f"{name}, median", "showlegend": True})
    layout = {
        "xaxis": axis("time since GNSS was lost [s]"),
        "yaxis": axis("horizontal error [m]", type="log", range=[-1.0, 3.0]),
        "showlegend": True,
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
    }
    caption = "Every outage thin, the median thick; against the receiver's INS/GPS reference."
    return Figure("Error growth without GNSS", caption, [Panel(data, layout, 380)])
