"""The bench: everything that a scenario describes, put together.

Receiver, IMU and velocimeter share the receiver's clock: their samples are taken when it shows
their times (design, architecture: IMU samples sit on the station's scale by construction).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

import numpy as np

from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.imu_errors import ImuErrors
from deepseis_core.imu_grades import grade_named
from deepseis_core.types import FloatArray, Station
from deepseis_sim.base_station import BaseStation
from deepseis_sim.bench_streams import (
    IfBlocks,
    ImuStream,
    Item,
    LdvStream,
    ObservationStream,
    PositionStream,
    Stream,
    TruthStream,
)
from deepseis_sim.gravity_lines import LinesMotion
from deepseis_sim.imu import ImuSynthesizer
from deepseis_sim.ldv import LdvSynthesizer
from deepseis_sim.motion import Motion, Surroundings
from deepseis_sim.motions import sum_of
from deepseis_sim.observation_model import ObservationModel
from deepseis_sim.oscillator import Oscillator
from deepseis_sim.recorded_motion import Recorded
from deepseis_sim.recording import FrontEnd, IfStream
from deepseis_sim.scenario import Scenario
from deepseis_sim.signal_model import SignalModel
from deepseis_sim.site import Site, orientation_xyzw
from deepseis_sim.sky import Sky, broadcast_ephemerides

BLOCK_SECONDS: Final = 0.02
SPAN_BLOCKS: Final = 10
"""Blocks made at once."""
SKY_STEP: Final = 30.0
"""Between points of the satellites' tracks in the truth file [s]."""


class Bench:
    """A scenario, ready to be run.

    Parameters
    ----------
    scenario : Scenario

    Attributes
    ----------
    motion : Motion
        Of the body's origin.
    gravity : GravityDisturbance or None
        Field of gravity beyond the normal one.
    stands_in : bool
        The motion is not the scenario's own: its record is not at hand.
    model : SignalModel
        What reaches the antenna.
    sample_count : int
        Length of the run.

    Raises
    ------
    InputError
        Settings or files make no sense.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.start: GpsTime = scenario.start.time
        self.site = Site(scenario.place.geodetic)
        with self._part("motion"):
            self.motion, self.stands_in = self._motion()
        with self._part("receiver"):
            self.clock = Oscillator(scenario.receiver.oscillator, scenario.seed, self.motion)
        antenna = self.site.trajectory(self.motion, scenario.lever_arm)
        with self._part("sky"):
            ephemerides = broadcast_ephemerides(
                self._beside(scenario.sky.nav_file), self.start, scenario.seed
            )
            self.sky = Sky(scenario.sky, ephemerides, self.start, antenna, scenario.duration)
        self.model = SignalModel(
            self.sky.satellites,
            self.start,
            antenna,
            clock=self.clock,
            ionosphere=scenario.sky.ionosphere,
            troposphere=scenario.sky.troposphere,
            seed=scenario.seed,
            cn0=self.sky.cn0_dbhz,
        )
        receiver = scenario.receiver
        self.sample_rate_hz = receiver.sample_rate_hz
        self.front_end = FrontEnd(
            receiver.format, receiver.sample_rate_hz, receiver.intermediate_frequency_hz
        )
        unit = receiver.format.samples_per_unit
        self.samples_per_block = round(BLOCK_SECONDS * self.sample_rate_hz) // unit * unit
        self.sample_count = round(scenario.duration * self.sample_rate_hz) // unit * unit
        self.antenna_ecef: FloatArray = antenna(np.zeros(1))[0]
        with self._part("gravity"):
            self.gravity = scenario.gravity.build(scenario.seed) if scenario.gravity else None
        with self._part("base"):
            self.base = self._base()
        self.imu_errors: ImuErrors | None = None
        self.streams = list(self._streams())

    def spans(self) -> Iterator[tuple[int, int]]:
        """Yield first sample, and the one after the last, of every piece of the run."""
        step = SPAN_BLOCKS * self.samples_per_block
        for begin in range(0, self.sample_count, step):
            yield begin, min(begin + step, self.sample_count)

    def items(self, begin: int, end: int) -> list[Item]:
        """Make everything that is valid in a span; spans must follow one another."""
        return [item for stream in self.streams for item in stream.between(begin, end)]

    def opening(self) -> list[Item]:
        """Return what holds from the start: the station, and orbits that no signal carries."""
        items = [Item(0, "station", self.station())]
        if not self.scenario.signal:
            items += [Item(0, "gnss/ephemeris", s.ephemeris) for s in self.model.satellites]
        return items

    def station(self) -> Station:
        """Describe the station as it stands before the motion."""
        scenario = self.scenario
        now = self.motion.at(np.zeros(1))
        C = np.reshape(now.C_enu_b, (-1, 3, 3))[0]
        return Station(
            name="DSEI",
            network="XX",
            monument_ecef=self.site.origin_ecef,
            antenna_lever_arm=C @ scenario.lever_arm + now.position[0],
            imu_to_antenna=scenario.lever_arm,
            imu_orientation_xyzw=np.reshape(orientation_xyzw(now), (-1, 4))[0],
            receiver="DeepSeis test bench",
            antenna="isotropic",
            imu=scenario.imu.grade if scenario.imu else "",
        )

    def truth_constants(self) -> dict[str, Any]:
        """Return the arrays of ``truth.npz`` that do not grow with its rows."""
        satellites = self.model.satellites
        sky_t = np.arange(0.0, self.scenario.duration + SKY_STEP, SKY_STEP)
        elevation, azimuth = self.sky.directions(sky_t)
        return {
            "prn": np.array([item.prn for item in satellites]),
            "satellites": np.array([item.satellite for item in satellites]),
            "elevation": np.array([item.elevation for item in satellites]),
            "azimuth": np.array([item.azimuth for item in satellites]),
            "cn0_dbhz": np.array([item.cn0_dbhz for item in satellites]),
            "sky_t_s": sky_t,
            "sky_elevation": elevation,
            "sky_azimuth": azimuth,
            "origin_ecef": self.site.origin_ecef,
            "start_week": self.start.week,
            "start_tow_ns": self.start.tow_ns,
            **self._imu_constants(),
            **self._line_constants(),
        }

    def figures(self) -> dict[str, Any]:
        """Return figures of the run for its summary; complete at its end."""
        scenario = self.scenario
        begin, end = (min(t, scenario.duration) for t in self.motion.span)
        figures: dict[str, Any] = {
            "satellites": [item.satellite for item in self.model.satellites],
            "sample_rate_hz": self.sample_rate_hz,
            "sample_count": self.sample_count,
            "motion_begin_s": begin,
            "motion_end_s": end,
            "motion_stands_in": self.stands_in,
        }
        if scenario.signal:
            figures |= {
                "if_format": self.front_end.format.to_text(),
                "intermediate_frequency_hz": self.front_end.intermediate_frequency_hz,
            }
        if self.base:
            baseline = np.linalg.norm(self.base.position_ecef - self.antenna_ecef)
            figures["baseline_m"] = round(float(baseline), 3)
        if self.imu_errors:
            figures["imu_clipped_samples"] = int(self.imu_errors.clipped.sum())
        return figures

    def records(self) -> Mapping[str, Mapping[str, Any]]:
        """Return what the bag says of its making."""
        s = self.scenario
        return {"scenario": {"name": s.name, "title": s.title, "seed": s.seed, "source": s.source}}

    @contextmanager
    def _part(self, name: str) -> Iterator[None]:
        """Say where in the scenario's file the part stands that makes no sense."""
        try:
            yield
        except InputError as error:
            place = self.scenario.places.get(name)
            raise (InputError(place, str(error)) if place else error) from None

    def _motion(self) -> tuple[Motion, bool]:
        s = self.scenario
        around = Surroundings(s.place.geodetic, s.duration, s.seed, s.folder)
        records = [s.folder / config.file for config in s.motion if isinstance(config, Recorded)]
        found = [any(path.parent.glob(f"{path.name}*")) for path in records]
        stands_in = bool(s.stand_in) and not all(found)
        return sum_of(s.stand_in if stands_in else s.motion, around), stands_in

    def _beside(self, name: str) -> str:
        return str(self.scenario.folder / name) if name else ""

    def _base(self) -> BaseStation | None:
        s = self.scenario
        if s.base is None:
            return None
        return BaseStation(
            self.model,
            s.place.geodetic,
            s.base,
            ionosphere=s.sky.ionosphere,
            troposphere=s.sky.troposphere,
            seed=s.seed,
            sample_rate_hz=self.sample_rate_hz,
        )

    def _streams(self) -> Iterator[Stream]:
        s, rate = self.scenario, self.sample_rate_hz
        yield TruthStream(
            self.model, self.sky, self.site, self.motion, s.lever_arm, (s.truth_rate_hz, rate)
        )
        if s.signal:
            with self._part("jammers"):
                stream = IfStream(
                    self.model,
                    self.front_end,
                    seed=s.seed,
                    jammers=s.jammers,
                    multipath=s.multipath,
                    agc_s=s.receiver.agc_s,
                )
            yield IfBlocks(stream, self.front_end, self.samples_per_block)
        else:
            with self._part("observations"):
                model = ObservationModel(
                    self.model, s.observations, cn0=self.sky.cn0_dbhz, seed=s.seed,
                    sample_rate_hz=rate,
                )  # fmt: skip
            yield ObservationStream("gnss/observations", model, self.start, rate)
        if s.imu:
            with self._part("imu"):
                imu = self._imu()
            yield imu
        if self.base:
            yield ObservationStream("base/observations", self.base, self.start, rate)
        if s.ldv:
            with self._part("ldv"):
                ldv = LdvSynthesizer(s.ldv, self.motion, s.seed, clock=self.clock)
            yield LdvStream(ldv, rate)
        if s.positions:
            rates = s.position_rate_hz, rate
            with self._part("positions"):
                positions = PositionStream(s.positions, self.model, self.site, rates, s.seed)
            yield positions

    def _imu(self) -> ImuStream:
        s = self.scenario
        assert s.imu is not None
        grade = grade_named(s.imu.grade)
        self.imu_errors = ImuErrors(grade, s.imu.rate_hz, s.seed)
        synthesizer = ImuSynthesizer(
            self.motion, self.site, s.imu.rate_hz, clock=self.clock, gravity=self.gravity
        )
        rates = s.imu.rate_hz, self.sample_rate_hz
        return ImuStream(synthesizer, self.imu_errors, grade, rates)

    def gravity_disturbance(self, time: FloatArray) -> FloatArray:
        """Return gravity in excess of normal gravity at the body [m/s^2], positive down, (m,).

        ``time`` is receiver time since the start [s].
        """
        if self.gravity is None:
            return np.zeros(time.size)
        return self.gravity(self.motion.at(time - self.clock(time)).position)

    def _line_constants(self) -> dict[str, Any]:
        """Return beginnings, ends and directions of survey lines, if the motion has any."""
        if not isinstance(self.motion, LinesMotion):
            return {}
        lines = self.motion.lines()
        return {"lines": np.array([(n.start_time, n.end_time, n.direction) for n in lines])}

    def _imu_constants(self) -> dict[str, Any]:
        if not self.imu_errors:
            return {}
        truth = self.imu_errors.truth(0, 1)
        return {
            "gyro_bias": truth.gyro_bias[0],
            "accel_bias": truth.accel_bias[0],
            "gyro_matrix": truth.gyro_matrix,
            "accel_matrix": truth.accel_matrix,
            "imu_to_antenna": np.asarray(self.scenario.lever_arm, np.float64),
        }
