"""A signal that somebody else simulated, made an input bag: an IMU on its antenna's true motion.

The recordings of ``if_captures/independent_sim`` come with the motion of their antenna. A body
that carries that antenna on a lever arm, without turning, moves with it; what an IMU of a grade
would have measured on it follows (`deepseis_sim.imu`, `deepseis_core.imu_errors`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from deepseis_bringup.bags.input_bag import ORDER, InputBag
from deepseis_core.baseband import Baseband
from deepseis_core.geodesy import geodetic_from_ecef
from deepseis_core.gps_time import GpsTime
from deepseis_core.if_format import IfFormat
from deepseis_core.imu_errors import ImuErrors
from deepseis_core.imu_grades import grade_named
from deepseis_core.types import FloatArray, IfBlock, Station
from deepseis_frontend.if_descriptor import IfDescriptor
from deepseis_frontend.if_file import IfFile
from deepseis_ins.truth_motion import Trajectory, TruthMotion
from deepseis_sim.bench_streams import ImuStream, Item
from deepseis_sim.imu import ImuSynthesizer
from deepseis_sim.motion import Kinematics
from deepseis_sim.site import Site, orientation_xyzw

SPAN_BLOCKS: Final = 10


@dataclass(frozen=True)
class OutsideRecording:
    """Samples and truth that came from elsewhere.

    Attributes
    ----------
    samples, truth : Path
    format : str
        Of the samples.
    sample_rate_hz : float
    start : GpsTime
        Of sample 0.
    """

    samples: Path
    truth: Path
    format: str
    sample_rate_hz: float
    start: GpsTime

    def descriptor(self) -> IfDescriptor:
        """Describe the samples."""
        packing = IfFormat.from_text(self.format)
        return IfDescriptor(packing, self.sample_rate_hz, 0.0, self.start.to_utc_ns())


@dataclass(frozen=True)
class CarriedImu:
    """An IMU on the body: grade, rate [Hz], lever arm to the antenna [m], heading of the body.

    The lever arm is forward-left-up; the heading is that of the forward axis, from north [deg].
    """

    grade: str = "span-fsas"
    rate_hz: float = 200.0
    lever_arm: tuple[float, float, float] = (0.4, -0.25, 0.9)
    heading_deg: float = 35.0


class Carried:
    """Motion of the body's origin, an antenna's motion given (`deepseis_sim.motion.Motion`).

    Parameters
    ----------
    antenna : Trajectory
    site : Site
        At the antenna's first place.
    imu : CarriedImu
    """

    rotates = False

    def __init__(self, antenna: Trajectory, site: Site, imu: CarriedImu) -> None:
        self.antenna, self.site = antenna, site
        east, north = (f(np.radians(imu.heading_deg)) for f in (np.sin, np.cos))
        self.C_enu_b = np.array([[east, -north, 0.0], [north, east, 0.0], [0.0, 0.0, 1.0]])
        self._lever = self.C_enu_b @ np.asarray(imu.lever_arm)
        time = antenna.time
        self.span = (float(time[0]), float(time[-1])) if antenna.moves else (0.0, 0.0)

    def at(self, time: FloatArray) -> Kinematics:
        """Evaluate at times [s]."""
        states = self.antenna.states(time)
        C = self.site.C_e_enu
        position = (states[:, :3] - self.site.origin_ecef) @ C - self._lever
        return Kinematics(position, states[:, 3:6] @ C, states[:, 6:] @ C, self.C_enu_b)


def write_outside_bag(
    recording: OutsideRecording,
    folder: Path,
    imu: CarriedImu,
    *,
    weaker_db: float = 0.0,
    seed: int = 1,
) -> FloatArray:
    """Write an input bag of a recording and an IMU carried with its antenna.

    Parameters
    ----------
    recording : OutsideRecording
    folder : Path
        Of the bag, made new.
    imu : CarriedImu
    weaker_db : float, optional
        White Gaussian noise of ``10^(weaker_db / 10) - 1`` of the samples' power is added to them,
        in both components, then they are rounded to 8 bits: the power of a weak signal in them
        stays, that of all noise in them is ``weaker_db`` more [dB].
    seed : int, optional
        Of the IMU and the noise.

    Returns
    -------
    ndarray, shape (3,)
        Where the antenna stands at first, ECEF [m].
    """
    antenna = TruthMotion(recording.truth).trajectory
    site = Site(geodetic_from_ecef(antenna.origin))
    motion = Carried(antenna, site, imu)
    grade = grade_named(imu.grade)
    stream = ImuStream(
        ImuSynthesizer(motion, site, imu.rate_hz),
        ImuErrors(grade, imu.rate_hz, seed),
        grade,
        (imu.rate_hz, recording.sample_rate_hz),
    )
    at_first = motion.at(np.zeros(1))
    station = Station(
        name="OUTS",
        network="XX",
        monument_ecef=site.origin_ecef,
        antenna_lever_arm=np.zeros(3),
        imu_to_antenna=np.asarray(imu.lever_arm),
        imu_orientation_xyzw=np.reshape(orientation_xyzw(at_first), (-1, 4))[0],
        imu=imu.grade,
    )
    blocks = IfFile(recording.samples, recording.descriptor()).blocks()
    if weaker_db > 0.0:
        blocks = _weaker(blocks, weaker_db, seed)
    with InputBag(folder, recording.start.to_utc_ns()) as bag:
        bag.write("station", station, 0)
        for block in blocks:
            offset = round(block.sample_index * 1e9 / block.sample_rate_hz)
            items = list(
                stream.between(block.sample_index, block.sample_index + block.sample_count)
            )
            items.append(Item(offset, "if/samples", block))
            for item in sorted(items, key=lambda item: (item.offset_ns, ORDER[item.topic])):
                bag.write(item.topic, item.value, item.offset_ns, item.stamp_ns)
    return antenna.origin


def _weaker(blocks: Iterator[IfBlock], weaker_db: float, seed: int) -> Iterator[IfBlock]:
    """Add noise to samples; levels of the noisy ones are 12 a unit of the r.m.s. before."""
    baseband: Baseband | None = None
    sd = np.float32(np.sqrt(10.0 ** (weaker_db / 10.0) - 1.0))
    for number, block in enumerate(blocks):
        baseband = baseband or Baseband.for_block(block)
        parts = np.stack(baseband.convert(block), axis=1).astype(np.float32)
        parts /= np.sqrt(np.mean(parts**2))
        noise = np.random.default_rng([seed, 29, number]).standard_normal(parts.shape, np.float32)
        levels = np.clip(np.rint(12.0 * (parts + sd * noise)), -127, 127).astype(np.int8)
        yield IfBlock(
            block.sample_index, block.sample_count, block.sample_rate_hz, 0.0, "iq8",
            levels.reshape(-1).view(np.uint8),
        )  # fmt: skip
