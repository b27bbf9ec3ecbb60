"""A real antenna at rest: where its phases say it is, second by second after calibrations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyrtklib as rtklib

from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.types import MotionKind, MotionState, Observations
from deepseis_pvt.ephemeris_book import EphemerisBook
from deepseis_pvt.precise import PhasePositions, PreciseConfig
from deepseis_pvt.rtklib_values import ROVER, read_observations, satellite_name

CALIBRATED_S, WATCHED_S = 120, 100
LOCKED = np.uint16(0)


def observations(path: Path) -> Iterator[Observations]:
    """Read GPS L1 of a RINEX file, one sample index a second [1 Hz]."""
    obs, epochs = read_observations(path, ROVER, rtklib.nav_t())
    for number, places in enumerate(epochs.values()):
        rows = [obs.data[i] for i in places]
        rows = [r for r in rows if satellite_name(r.sat)[0] == "G" and r.P[0] and r.L[0]]
        week = rtklib.Arr1Dint(1)
        tow = rtklib.time2gpst(rows[0].time, week)
        nothing = np.zeros(len(rows), np.float32)
        yield Observations(
            sample_index=number, sample_fraction=0.0, week=int(week[0]), tow_ns=round(tow * 1e9),
            valid_through=number, interval=1.0,
            satellites=tuple(satellite_name(r.sat) for r in rows),
            pseudorange=np.array([r.P[0] for r in rows]),
            carrier_phase_cycles=np.array([r.L[0] for r in rows]),
            carrier_doppler_hz=np.array([r.D[0] for r in rows]),
            cn0_dbhz=np.array([r.SNR[0] * rtklib.SNR_UNIT for r in rows], np.float32),
            lli=np.array([r.LLI[0] & 3 for r in rows], np.uint8),
            lock_time=nothing + 1e4, carrier_error_cycles=nothing,
            carrier_error_sd_cycles=nothing, code_error_chips=nothing,
            code_error_sd_chips=nothing, flags=np.full(len(rows), LOCKED),
        )  # fmt: skip


@dataclass
class Watched:
    """Displacements [m], their covariances and squared normalised ones, by seconds since then."""

    displacement: np.ndarray
    covariance: np.ndarray
    normalised: np.ndarray


def watch(shared_data: Path) -> Watched:
    """Calibrate for 120 s and watch for 100 s, again and again over the recording."""
    home = shared_data / "rinex" / "cssrlib_5km_1hz"
    file = read_rinex_nav(home / "SEPT078M.21P")
    epochs = list(observations(home / "SEPT078M.21O"))
    # The antenna as the data's publisher has it, to centimetres; the header's is 0.9 m off.
    antenna = np.array([-3962108.673, 3381309.574, 3668678.638])
    found = []
    for start in range(0, len(epochs) - CALIBRATED_S - WATCHED_S, 40):
        book = EphemerisBook(7200.0)
        for ephemeris in file.ephemerides:
            if ephemeris.satellite[0] == "G":
                book.add(ephemeris)
        solver = PhasePositions(antenna, book, PreciseConfig(wait_motion=True))
        still = start + CALIBRATED_S
        none = np.zeros(6, np.float32)
        for kind, since in ((MotionKind.STATIC, 0), (MotionKind.MOVING, still)):
            solver.push_motion(MotionState(since, since, int(kind), "fast", none, none))
        solver.motion_valid(len(epochs))
        values = [solver.solve(epoch) for epoch in epochs[start : still + WATCHED_S + 1]]
        found.append(values[CALIBRATED_S:])
    away = np.array([[v.displacement_enu for v in run] for run in found])
    sure = np.array([[v.covariance_enu for v in run] for run in found])
    return Watched(away, sure, np.einsum("...i,...ij,...j", away, np.linalg.inv(sure), away))
