"""A signal that nobody here made, moving at 1.9 g, through the whole chain with the INS aiding.

Data ``if_captures/independent_sim``: 10 s still, then a circle of 12 cm at 2 Hz; 4 MHz, 1 bit. The
IMU is synthesised on the truth's motion (`outside_recording`): SPAN-FSAS with its errors,
on a lever arm of a metre. The signal has no troposphere: none is modelled. Nothing of the truth
reaches the chain but through the IMU, the survey and coarse time.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepseis_bringup.accept.figures import error_figure
from deepseis_bringup.accept.loop_measures import CarrierTruth, phase_errors, pooled
from deepseis_bringup.accept.outside_recording import (
    CarriedImu,
    OutsideRecording,
    write_outside_bag,
)
from deepseis_bringup.accept.scene import RATE_HZ, Outcome, Recorded, Work, aided
from deepseis_bringup.accept.tables import Goal, Row
from deepseis_core.constants import L1_WAVELENGTH
from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import FloatArray
from deepseis_sim.scenario import data_folder

FOLDER: Final = Path("if_captures") / "independent_sim"
ONE_BIT_DB: Final = 2.0
"""What 1 bit takes (README of the recordings)."""
MASK_DEG: Final = 10.0
STILL: Final = (6.0, 9.8)
MOVING: Final = (11.0, 29.8)
FREQUENCY_HZ: Final = 2.0
TABLE: Final = "Independent signal, circle of 12 cm at 2 Hz"
PEERS: Final = "best of others: 4.8 (GNSS-SDR), 2.8 (PocketSDR)"
"""50 Hz loops on files of the same simulator, 8 bits; median of satellites [deg]."""
WEAK_PEERS: Final = "4 of 7"


def recording_of(data: Path) -> OutsideRecording:
    """Return the moving recording in a folder of data."""
    folder = data / FOLDER
    return OutsideRecording(
        folder / "circle_12cm_2hz_30s_4MHz_1bit_iq.bin",
        folder / "circle_12cm_2hz_truth.npz",
        "iq1 positive=1 order=msb_first",
        RATE_HZ,
        GpsTime.from_calendar(2022, 1, 1, 2, 0, 30 * 10**9),
    )


class IndependentScene(Recorded):
    """The recording with an IMU, as an input bag.

    Parameters
    ----------
    data : Path
        Folder of recordings.
    place : Path
        For the bag.
    imu : CarriedImu
    weaker_db : float
        Noise added to the samples lowers C/N0 by this [dB].
    """

    def __init__(
        self, data: Path, place: Path, imu: CarriedImu, *, weaker_db: float = 0.0
    ) -> None:
        recording = recording_of(data)
        antenna = write_outside_bag(recording, place, imu, weaker_db=weaker_db)
        with np.load(recording.truth) as file:
            high = file["el_deg"] > MASK_DEG
            phase = file["carrier_phase_cycles"][:, high]
            cn0 = file["cn0_dbhz_before_quantising"][high] - weaker_db
            elevation, azimuth = (np.radians(file[name][high]) for name in ("el_deg", "az_deg"))
            truth = CarrierTruth(
                tuple(f"G{prn:02d}" for prn in file["prn"][high]),
                file["t_s"], phase, np.tile(cn0, (len(phase), 1)), elevation,
            )  # fmt: skip
            self.motion_t, self.antenna = file["motion_t_s"], file["antenna_ecef_m"]
        self.azimuth, self.imu = azimuth, imu
        settings: dict[str, dict[str, Any]] = {"pvt": {"troposphere": False}}
        if weaker_db > 0.0:
            settings["acquisition"] = {"noncoherent_count": 100}
        super().__init__(
            "independent" + (f", {weaker_db:g} dB weaker" if weaker_db else ""),
            place,
            data / FOLDER / "brdc0010.22n",
            truth,
            antenna,
            recording.start.week,
            STILL,
            MOVING,
            ONE_BIT_DB,
            settings,
        )


def independent_signal(work: Work) -> None:
    """Give the rows of the recording as it is, and weaker; without the data, say so."""
    data = data_folder()
    if not (data / FOLDER).is_dir():
        work.acceptance.remarks.append(f"Not at hand, and left out: {data / FOLDER}.")
        return
    work.say("independent signal: IMU on its motion")
    imu = CarriedImu()
    scene = IndependentScene(data, work.folder / "independent", imu)
    outcomes = [work.run(scene, loop) for loop in (aided(8.0), aided(3.0))]
    for outcome in outcomes:
        work.acceptance.add(*_rows(scene, outcome, imu.grade))
    other = replace(imu, grade="mti-g")
    mems = IndependentScene(data, work.folder / "independent-mems", other)
    work.acceptance.add(*_rows(mems, work.run(mems, aided(8.0)), other.grade))
    figure = error_figure(scene.name, outcomes, scene.truth, RATE_HZ, scene.still, scene.moving)
    work.acceptance.figures.append((TABLE, [figure]))
    for weaker_db in (8.0, 10.0):
        place = work.folder / f"independent-{weaker_db:g}"
        weak = IndependentScene(data, place, imu, weaker_db=weaker_db)
        work.acceptance.add(*_weak_rows(weak, work.run(weak, aided(3.0)), weaker_db))


def _rows(scene: IndependentScene, outcome: Outcome, grade: str) -> list[Row]:
    scenario = f"{scene.name}, {outcome.loop.name}, {grade}"
    moving, of = outcome.moving, float(len(outcome.moving))
    middle = float(np.median([item.error_rms for item in moving]))
    error, gain = displacement(scene, outcome)
    goal_deg = Goal.at_most(1.3)
    return [
        Row(TABLE, scenario, "satellites held without slip", "-", float(outcome.held()),
            goal=Goal.at_least(of), limit=of),
        Row(TABLE, scenario, "true phase error, all of it, median of satellites, moving", "deg",
            middle, PEERS, goal_deg),
        Row(TABLE, scenario, "the same, still", "deg",
            float(np.median([item.error_rms for item in outcome.still])), None, goal_deg),
        Row(TABLE, scenario, "the same, moving, worst satellite", "deg",
            max(item.error_rms for item in moving)),
        Row(TABLE, scenario, "true phase error / thermal limit, all satellites", "-",
            pooled(outcome.ratios()), goal=Goal.at_most(1.10), limit=1.0),
        Row(TABLE, scenario, "displacement from the phase, horizontal RMS", "mm",
            1e3 * float(np.hypot(*error[:2])), "best of others 4.9", Goal.at_most(1.0)),
        Row(TABLE, scenario, "displacement from the phase, gain at 2 Hz", "-", gain,
            "best of others 1.016", Goal.near(1.0, 0.002)),
    ]  # fmt: skip


def _weak_rows(scene: IndependentScene, outcome: Outcome, weaker_db: float) -> list[Row]:
    levels = [item.cn0_dbhz - ONE_BIT_DB for item in outcome.moving]
    scenario = (
        f"independent, {weaker_db:g} dB by noise added and 2 dB by 1 bit: {min(levels):.0f} to "
        f"{max(levels):.0f} dB-Hz, {outcome.loop.name}"
    )
    of = float(len(scene.truth.satellites))
    return [
        Row(TABLE, scenario, "satellites held without slip", "-", float(outcome.held()),
            WEAK_PEERS, Goal.at_least(of), of),
        Row(TABLE, scenario, "true phase error, all of it, median of satellites, moving", "deg",
            float(np.median([item.error_rms for item in outcome.moving])), "about 9",
            Goal.at_most(4.0)),
        Row(TABLE, scenario, "the same, worst satellite", "deg",
            max(item.error_rms for item in outcome.moving)),
        Row(TABLE, scenario, "true phase error / thermal limit, all satellites", "-",
            pooled(outcome.ratios()), goal=Goal.at_most(1.10), limit=1.0),
    ]  # fmt: skip


def displacement(scene: IndependentScene, outcome: Outcome) -> tuple[FloatArray, float]:
    """Return what the phases say of the antenna's motion: errors east, north, up [m], and gain.

    Least squares with a receiver clock over the satellites, orbits and satellite clocks known; the
    phases are weighted as their noise goes. The gain is that of the circle at 2 Hz.
    """
    truth = scene.truth
    t = truth.t
    inside = (t >= scene.moving[0]) & (t < scene.moving[1])
    error = phase_errors(outcome.tracks, truth, RATE_HZ)
    still = (t >= scene.still[0]) & (t < scene.still[1])
    error = error[inside] - np.nanmean(error[still], axis=0)
    # A phase that grows is a range that shrinks: along the line of sight an antenna comes nearer.
    cos, sin = np.cos(truth.elevation), np.sin(truth.elevation)
    towards = np.column_stack([cos * np.sin(scene.azimuth), cos * np.cos(scene.azimuth), sin])
    design = np.column_stack([towards, np.ones(len(towards))])
    weight = 10.0 ** (truth.cn0_dbhz[0] / 10.0)
    solve = np.linalg.solve(design.T @ (weight[:, None] * design), design.T * weight)
    wrong = (L1_WAVELENGTH * error @ solve.T)[:, :3]
    wrong -= wrong.mean(axis=0)
    true = _true_enu(scene, t[inside])
    wave = np.exp(-2j * np.pi * FREQUENCY_HZ * t[inside])
    whole = np.abs(wave @ (true - true.mean(axis=0))[:, :2])
    seen = np.abs(wave @ (true - true.mean(axis=0) + wrong)[:, :2])
    return np.sqrt(np.mean(wrong**2, axis=0)), float(np.linalg.norm(seen) / np.linalg.norm(whole))


def _true_enu(scene: IndependentScene, t: FloatArray) -> FloatArray:
    latitude, longitude, _ = geodetic_from_ecef(scene.antenna_ecef)
    moved = (scene.antenna - scene.antenna_ecef) @ rotation_enu_ecef(latitude, longitude).T
    return np.column_stack([np.interp(t, scene.motion_t, axis) for axis in moved.T])
