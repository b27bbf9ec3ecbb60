"""A scenario of the test bench: where, when, what moves, what is measured. Filled from YAML.

A scenario's file holds the fields of `Scenario`; its ``short:`` section holds what differs in the
short form. The scenarios of the papers lie in the folder ``scenarios`` of this package.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.gps_time import GpsTime
from deepseis_core.if_format import IfFormat
from deepseis_core.imu_grades import grade_named
from deepseis_core.types import FloatArray
from deepseis_core.yaml_config import Entry, fill, overlay, override, read_yaml
from deepseis_sim import artificial_earthquake, drive, gravity_lines, motions, recorded_motion
from deepseis_sim.base_station import BaseConfig
from deepseis_sim.gravity_field import GravityField
from deepseis_sim.jammer import JammerConfig
from deepseis_sim.ldv import LdvConfig
from deepseis_sim.motion import MotionConfig
from deepseis_sim.multipath import MultipathConfig
from deepseis_sim.observation_model import ObservationConfig
from deepseis_sim.oscillator import OscillatorConfig
from deepseis_sim.position_errors import PositionErrorConfig
from deepseis_sim.sky import SkyConfig

FOLDER: Final = Path(str(files("deepseis_sim"))) / "scenarios"
HALF_LOBE_HZ: Final = 0.5e6
"""This much beside its middle frequency a signal needs at least."""
DATA_VARIABLE: Final = "DEEPSEIS_DATA"
"""Environment variable: the folder in which the papers' scenarios look for recordings."""

MOTION_KINDS: Final[Mapping[str, type]] = {
    **motions.MOTION_KINDS,
    **recorded_motion.MOTION_KINDS,
    **artificial_earthquake.MOTION_KINDS,
    **drive.MOTION_KINDS,
    **gravity_lines.MOTION_KINDS,
}


@dataclass(frozen=True)
class PlaceConfig:
    """Where the body stands before it moves; the tangent frame's origin."""

    latitude_deg: float = setting(38.7292, "latitude [deg]", low=-90.0, high=90.0)
    longitude_deg: float = setting(141.0217, "longitude [deg]", low=-180.0, high=360.0)
    height: float = setting(40.0, "height above the ellipsoid [m]", low=-500.0, high=1e5)

    @property
    def geodetic(self) -> tuple[float, float, float]:
        """Latitude [rad], longitude [rad], height [m]."""
        return math.radians(self.latitude_deg), math.radians(self.longitude_deg), self.height

    @property
    def ecef(self) -> FloatArray:
        """Position [m]."""
        return ecef_from_geodetic(np.array(self.geodetic))


@dataclass(frozen=True)
class StartConfig:
    """GPS time at which the receiver's clock shows sample 0.

    The default is 2 s before a subframe 1, page 18 follows in its frame, and 12 satellites are up.
    """

    week: int = setting(2399, "GPS week; stamps of messages end in 3028", low=0, high=3027)
    tow: int = setting(415258, "second of week [s]", low=0, high=604799)

    @property
    def time(self) -> GpsTime:
        """The same as a time."""
        return GpsTime(self.week, self.tow * 10**9)


@dataclass(frozen=True)
class ImuConfig:
    """The inertial measurement unit, at the body's origin."""

    grade: str = setting("span-fsas", "grade of the sensors (deepseis_core.imu_grades)")
    rate_hz: float = setting(200.0, "samples a second [Hz]", low=10.0, high=2000.0)
    lever_arm: tuple[float, float, float] = setting(
        (0.05, -0.03, 0.30), "from the IMU to the antenna, forward, left, up [m]"
    )


@dataclass(frozen=True)
class ReceiverConfig:
    """Front end and oscillator."""

    if_format: str = setting("iq4", "packing of the samples (deepseis_core.if_format)")
    sample_rate_hz: float = setting(4.0e6, "sample rate [Hz]", low=1e6, high=1e8)
    intermediate_frequency_hz: float = setting(0.0, "intermediate frequency [Hz]")
    agc_s: float = setting(0.0, "time constant of the gain; 0: fixed [s]", low=0.0, high=100.0)
    oscillator: OscillatorConfig = field(default_factory=OscillatorConfig)

    @property
    def format(self) -> IfFormat:
        """Packing of the samples."""
        return IfFormat.from_text(self.if_format)


@dataclass(frozen=True)
class Scenario:
    """Everything that the bench needs to know; same scenario, same bytes.

    ``changes`` are the settings that were changed when it was loaded, ``places`` the file and line
    of each part.
    """

    name: str = setting("", "name; set from the file's")
    title: str = setting("", "one line for people")
    source: str = setting("", "where it comes from")
    seed: int = setting(1, "of everything drawn by chance", low=0, high=2**31)
    duration: float = setting(60.0, "length [s]", low=0.1, high=1e5)
    signal: bool = setting(True, "make IF samples; else observations in their place")
    truth_rate_hz: int = setting(1000, "epochs of true motion a second", low=1, high=4000)
    place: PlaceConfig = field(default_factory=PlaceConfig)
    start: StartConfig = field(default_factory=StartConfig)
    motion: tuple[MotionConfig, ...] = ()
    stand_in: tuple[MotionConfig, ...] = ()
    sky: SkyConfig = field(default_factory=SkyConfig)
    receiver: ReceiverConfig = field(default_factory=ReceiverConfig)
    jammers: tuple[JammerConfig, ...] = ()
    multipath: MultipathConfig | None = None
    imu: ImuConfig | None = field(default_factory=ImuConfig)
    base: BaseConfig | None = None
    observations: ObservationConfig = field(default_factory=ObservationConfig)
    positions: PositionErrorConfig | None = None
    position_rate_hz: float = setting(1.0, "rate of such positions [Hz]", low=0.01, high=100.0)
    ldv: LdvConfig | None = None
    gravity: GravityField | None = None
    folder: Path = field(default=Path(), init=False)
    short: bool = field(default=False, init=False)
    changes: tuple[str, ...] = field(default=(), init=False)
    places: Mapping[str, str] = field(default_factory=dict, init=False)

    @property
    def lever_arm(self) -> FloatArray:
        """From the body's origin to the antenna, forward, left, up [m]."""
        return np.array(self.imu.lever_arm if self.imu else (0.0, 0.0, 0.0))


def scenario_names() -> tuple[str, ...]:
    """Return the names of the scenarios that come with the package."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.yaml")))


def load_scenario(name: str, *, short: bool = False, settings: Iterable[str] = ()) -> Scenario:
    """Read a scenario.

    Parameters
    ----------
    name : str
        One of `scenario_names`, or the path of a YAML file.
    short : bool, optional
        Its short form.
    settings : iterable of str, optional
        Changes such as ``imu.grade=mti-g``, last ones win.

    Raises
    ------
    InputError
        With the line and the reason.
    """
    path = _path(name)
    tree = read_yaml(path)
    brief = tree.value.pop("short", None)
    brief = None if brief and brief.value is None else brief
    if short and brief is None:
        raise InputError(path, "has no short form", "leave out --short")
    if brief is not None:
        _fill(overlay(tree, brief))  # a fault in the short form shows in the long one too
        tree = overlay(tree, brief) if short else tree
    settings = tuple(settings)
    if any(_names_a_record(text) for text in settings):
        tree.value.pop("stand_in", None)  # who names a record wants that one
    for text in settings:
        tree = override(tree, text)
    scenario = _fill(tree)
    of_load = {
        "name": scenario.name or path.stem,
        "folder": data_folder() if path.parent == FOLDER else path.parent,
        "short": short,
        "changes": settings,
        "places": {key: entry.where for key, entry in tree.value.items()},
    }
    for key, value in of_load.items():
        object.__setattr__(scenario, key, value)
    return scenario


def _names_a_record(text: str) -> bool:
    return bool(re.match(r"\s*motion\.\d+\.file\s*=", text))


def _fill(tree: Entry) -> Scenario:
    scenario = fill(Scenario, tree, {MotionConfig: MOTION_KINDS})
    if scenario.imu:
        try:
            grade_named(scenario.imu.grade)
        except InputError as error:
            place = tree.value["imu"].value["grade"].where
            raise InputError(place, f"{error.what} {error.reason}", error.hint) from None
    where = tree.value.get("receiver", tree).where
    try:
        packing = scenario.receiver.format
    except InputError as error:
        raise InputError(where, f"if_format: {error}") from None
    middle, rate = scenario.receiver.intermediate_frequency_hz, scenario.receiver.sample_rate_hz
    low, high = (0.0 if packing.is_real else -rate / 2), rate / 2
    if scenario.signal and not low + HALF_LOBE_HZ <= middle <= high - HALF_LOBE_HZ:
        reason = f"a signal at {middle:g} Hz does not fit into {low:g} to {high:g} Hz"
        raise InputError(where, reason, "set intermediate_frequency_hz (--if-hz)")
    return scenario


def _path(name: str) -> Path:
    known = FOLDER / f"{name}.yaml"
    if name in scenario_names():
        return known
    path = Path(name)
    if path.suffix not in (".yaml", ".yml"):
        hint = "known: " + ", ".join(scenario_names()) + "; or name a .yaml file"
        raise InputError(f"scenario {name}", "is not known", hint)
    return path


def data_folder() -> Path:
    """Return where the papers' scenarios look: the variable's folder, or ../shared/data."""
    given = os.environ.get(DATA_VARIABLE)
    if given:
        return Path(given)
    for parent in Path(__file__).resolve().parents:
        if (parent / "deepseis").is_file():
            return parent.parent / "shared" / "data"
    return Path()


def summary_of(scenario: Scenario) -> dict[str, Any]:
    """Return the figures that identify a scenario."""
    return {
        "scenario": scenario.name,
        "title": scenario.title,
        "source": scenario.source,
        "short": scenario.short,
        "changes": list(scenario.changes),
        "seed": scenario.seed,
        "duration_s": scenario.duration,
        "imu_grade": scenario.imu.grade if scenario.imu else "",
    }
