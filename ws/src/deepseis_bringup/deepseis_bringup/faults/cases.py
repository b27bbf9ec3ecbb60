"""The faults of the acceptance: what is done to which scene, and when."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepseis_bringup.accept.scene import Recorded, Scene
from deepseis_bringup.faults.faulty_bag import faulty_bag
from deepseis_core.imu_grades import STANDARD_GRAVITY
from deepseis_sim.bench import Bench
from deepseis_sim.faults import Fault
from deepseis_sim.scenario import Scenario, load_scenario

QUAKE: Final = "quake"
CIRCLE: Final = "sine-2hz"
AT: Final = {QUAKE: 34.5, CIRCLE: 26.0}
"""Beginning of the faults [s]: before the quake's peak of 3 g at 35 s; in the circle's 2 g."""
CIRCLING: Final = 19.0, 48.0
"""From before the circle turns on, and for how long [s]."""
GRADE: Final = "span-fsas"
"""Of both scenes' IMU."""
CLIP_G: Final = 1.5
GAP_S: Final = 0.4
MASK_EVERY_S: Final = 5.0
MASKED_S: Final = 2.0
SCENES: Final[dict[str, tuple[str, ...]]] = {
    QUAKE: (),
    CIRCLE: ("duration=68.0", "motion.0.duration=46.0"),
}
"""Settings of the short forms: the circle is long enough for 30 s without a signal."""


@dataclass(frozen=True)
class Case:
    """One fault in one scene.

    Attributes
    ----------
    name, scene : str
    begin, end : float
        When the input is spoilt [s].
    faults : sequence of Fault
        Put into the recording.
    parameters : mapping of mappings
        Of nodes.
    aiding_away : bool
        In that time the trackers get no aiding; the chain in one process.
    masked : bool
        The scene has satellites masked in turn.
    base : bool
        The graph solves against the base too.
    outage : bool
        An input is away altogether, then comes back: recovery has a goal.
    """

    name: str
    scene: str
    begin: float
    end: float
    faults: Sequence[Fault] = ()
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    aiding_away: bool = False
    masked: bool = False
    base: bool = False
    outage: bool = True

    @property
    def label(self) -> str:
        """Name with its scene."""
        return f"{self.scene}: {self.name}"


def cases() -> tuple[Case, ...]:
    """Return all cases."""
    return tuple(case for scene in SCENES for case in _of(scene))


def _of(scene: str) -> list[Case]:
    long, at = scene == CIRCLE, AT[scene]
    dark = 30.0 if long else 3.0
    clip = Fault("imu-clip", at, 4.0, CLIP_G * STANDARD_GRAVITY)
    ranged = {"fusion": {"imu_grade": f"{GRADE} accel_range_g={CLIP_G:g}"}}
    known = _with(f"IMU clips at {CLIP_G:g} g, 4 s", scene, clip, parameters=ranged)
    if long:  # a sensor of that range clips as long as the circle turns
        longer = Fault("imu-clip", *CIRCLING, clip.amount)
        name = f"IMU clips at {CLIP_G:g} g throughout"
        known = _with(name, scene, longer, parameters=ranged, outage=False)
    found = [
        Case("no fault", scene, at, at + 1.0, outage=False),
        _with("IMU gap of 1 s", scene, Fault("imu-gap", at, 1.0)),
        known,
        _with(f"IMU clips at {CLIP_G:g} g, 4 s, range not known", scene, clip, outage=False),
        _with(f"no signal for {dark:g} s", scene, Fault("no-signal", at, dark)),
        _with(f"IF gap of {GAP_S:g} s", scene, Fault("if-gap", at, GAP_S)),
        Case("aiding away for 3 s", scene, at, at + 3.0, aiding_away=True),
    ]
    if not long:
        found += [
            _with("30 % of IMU samples missing", scene,
                  Fault("imu-sparse", 20.0, 20.0, 0.3), outage=False),
            Case("a satellite masked every 5 s", scene, 21.0, 40.0, masked=True, outage=False),
            Case("base, no fault", scene, at, at + 1.0, base=True, outage=False),
            _with("base lost", scene, Fault("base-gap", 26.0, 18.0), base=True, outage=False),
        ]  # fmt: skip
    return found


def _with(name: str, scene: str, fault: Fault, **more: Any) -> Case:
    return Case(name, scene, fault.start, fault.end, (fault,), **more)


def masked(scenario: Scenario, outages: Iterable[tuple[int, float, float]]) -> str:
    """Return the setting of the sky that hides satellites for a while.

    Parameters
    ----------
    scenario : Scenario
    outages : iterable of tuple
        Which, counted from the highest, and from when to when [s].
    """
    sky = Bench(scenario).sky
    parts = []
    for number, begin, end in outages:
        elevations, azimuths = sky.directions(np.array([0.5 * (begin + end)]))
        order = np.argsort(-elevations[0])
        azimuth = float(np.degrees(azimuths[0, order[number % order.size]]))
        parts.append(
            f"{{azimuth_from_deg: {azimuth - 1.0:.3f}, azimuth_to_deg: {azimuth + 1.0:.3f}, "
            f"from_s: {begin:.3f}, to_s: {end:.3f}}}"
        )
    return f"sky.obstructions=[{', '.join(parts)}]"


class Scenes:
    """Scenes of the cases, simulated when first needed.

    Parameters
    ----------
    folder : Path
        For their files.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: dict[tuple[str, bool], Scene] = {}

    def of(self, case: Case) -> Scene:
        """Return a case's scene, without its faults."""
        key = case.scene, case.masked
        if key not in self._known:
            settings = SCENES[case.scene]
            if case.masked:
                scenario = load_scenario(case.scene, short=True, settings=settings)
                times = np.arange(case.begin, case.end - MASKED_S, MASK_EVERY_S)
                outages = [(k, t, t + MASKED_S) for k, t in enumerate(times)]
                settings = (*settings, masked(scenario, outages))
            label = "-masked" if case.masked else ""
            self._known[key] = Scene(
                case.scene, self.folder, short=True, settings=settings, label=label
            )
        return self._known[key]

    def spoilt(self, case: Case) -> tuple[Scene, Recorded]:
        """Return a case's scene, and its recording with the faults."""
        scene = self.of(case)
        if not case.faults:
            return scene, scene
        folder = self.folder / f"spoilt-{case.scene}"
        faulty_bag(scene.bag, folder, case.faults)
        return scene, Recorded(
            scene.name, folder / "bag", folder / "nav.rnx", scene.truth, scene.antenna_ecef,
            scene.week, scene.still, scene.moving,
        )  # fmt: skip
