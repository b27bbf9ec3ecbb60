"""The one description of the graph: nodes, topics, who waits for whom.

Launch files, the supervisor, the recorder and the compose file all come from here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from deepseis_core.errors import InputError
from deepseis_core.imu_grades import grade_named
from deepseis_core.interface import SHARED_TOPICS
from deepseis_frontend.imu_open import is_bag

ALL_SATELLITES = tuple(f"G{prn:02d}" for prn in range(1, 33))

TYPES: Mapping[str, tuple[str, str]] = {
    "if/samples": ("deepseis_msgs/msg/IfBlock", "stream"),
    "imu/data_raw": ("sensor_msgs/msg/Imu", "imu"),
    "ldv/velocity": ("deepseis_msgs/msg/LdvVelocity", "stream"),
    "base/observations": ("deepseis_msgs/msg/Observations", "stream"),
    "base/reference": ("deepseis_msgs/msg/Station", "latched"),
    "station": ("deepseis_msgs/msg/Station", "latched"),
    "truth": ("deepseis_msgs/msg/Truth", "stream"),
    "acquisition/request": ("deepseis_msgs/msg/AcquisitionRequest", "latched"),
    "acquisition/result": ("deepseis_msgs/msg/AcquisitionResult", "latched"),
    "tracking/<sat>/epochs": ("deepseis_msgs/msg/TrackingEpochs", "stream"),
    "gnss/ephemeris": ("deepseis_msgs/msg/Ephemeris", "latched"),
    "gnss/observations": ("deepseis_msgs/msg/Observations", "stream"),
    "gnss/pvt": ("deepseis_msgs/msg/Pvt", "stream"),
    "gnss/precise": ("deepseis_msgs/msg/PrecisePosition", "stream"),
    "gnss/rtk": ("deepseis_msgs/msg/PrecisePosition", "stream"),
    "gnss/fix": ("sensor_msgs/msg/NavSatFix", "stream"),
    "gnss/time_reference": ("sensor_msgs/msg/TimeReference", "stream"),
    "aiding/doppler": ("deepseis_msgs/msg/DopplerAiding", "stream"),
    "motion/state": ("deepseis_msgs/msg/MotionState", "latched"),
    "ins/solution": ("deepseis_msgs/msg/InsSolution", "stream"),
    "ins/odometry": ("nav_msgs/msg/Odometry", "stream"),
    "seismo/displacement": ("deepseis_msgs/msg/Displacement", "stream"),
    "seismo/event": ("deepseis_msgs/msg/SeismicEvent", "latched"),
    "/diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", "stream"),
}
"""Type and quality of service of every topic that is recorded or played."""

INPUTS_OF_COUPLINGS: Mapping[str, tuple[str, ...]] = {
    "tight": ("gnss/observations",),
    "ldv": ("ldv/velocity",),
}
"""What the fusion listens to beside what it does in any coupling."""

ONLOOKER = "watch"
"""Flow member that looks on and takes no part."""

KINDS = (
    *("if_source", "imu_source", "ldv_source", "base_source", "acquisition", "tracker", "pvt"),
    *("motion_state", "fusion", "seismic_event", "truth_aiding", "recorder"),
)
"""Kinds of nodes; overrides of parameters go by kind."""


@dataclass(frozen=True)
class GraphConfig:
    """What the station runs.

    ``one_process`` hosts all satellites together; otherwise each has its own process.
    ``aiding`` names who publishes aiding: empty, ``fusion`` (the inertial half of the graph), or
    ``truth`` (bench only).
    ``base``: there is a base station; it is played, and pvt solves against it. It is in the
    source's bag, or ``base_from`` says where: a bag, RINEX, RTCM 3 from a file, NTRIP or TCP.
    ``imu_file``: where the IMU is, if not in the bag that is the source.
    ``watched``: a `deepseis_bringup.watch.GraphWatch` looks on, and the source waits for it.
    ``misses``: lockstep: what the run that is replayed did not wait for, by node.
    ``parameters`` are overrides by node kind (``if_source``, ``tracker``, ``pvt``, ...).
    """

    source: Mapping[str, Any]
    sample_rate_hz: float
    satellites: tuple[str, ...] = ALL_SATELLITES
    mode: str = "lockstep"
    one_process: bool = True
    aiding: str = ""
    base: bool = False
    base_from: str = ""
    imu_file: str = ""
    record_dir: str = ""
    record_if: bool = True
    output_dir: str = ""
    watched: bool = False
    misses: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def coupling(self) -> str:
        """What moves the fusion's filter; empty without it."""
        given = self.parameters.get("fusion", {})
        return str(given.get("coupling", "loose")) if self.aiding == "fusion" else ""


@dataclass(frozen=True)
class NodeSpec:
    """One process of the graph: ``name`` is its flow member."""

    name: str
    package: str
    executable: str
    kind: str
    publishes: tuple[str, ...]
    subscribes: tuple[str, ...]
    node_name: str
    parameters: Mapping[str, Any]
    more_remaps: tuple[str, ...] = ()

    def ros_parameters(self) -> dict[str, Any]:
        """Return the parameters as ROS files hold them; empty lists are left at their default."""
        plain = {k: list(v) if isinstance(v, tuple) else v for k, v in self.parameters.items()}
        return {k: v for k, v in plain.items() if v != []}

    def remaps(self) -> list[str]:
        """Return the remapping rules; one names the process' first node, and no other in it."""
        named = self.node_name != self.executable
        return [f"{self.executable}:__node:={self.node_name}"] * named + list(self.more_remaps)


def _epoch_topics(satellites: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"tracking/{satellite}/epochs" for satellite in satellites)


def _trackers(config: GraphConfig) -> list[NodeSpec]:
    """Return the tracker processes: one container, or one for each satellite."""
    aiding = ("aiding/doppler",) if config.aiding else ()
    inputs = ("if/samples", "acquisition/result", *aiding)
    common = {"aiding": bool(config.aiding), "wait_acquisition": True}

    def spec(name: str, executable: str, node_name: str, satellites: tuple[str, ...]) -> NodeSpec:
        outputs = (*_epoch_topics(satellites), "gnss/ephemeris", "acquisition/request")
        own: dict[str, Any] = {"satellites": list(config.satellites)}
        own |= {"satellite": satellites[0]} if executable == "tracker" else {}
        outputs = (*outputs, "/diagnostics")
        return NodeSpec(
            name,
            "deepseis_tracking",
            executable,
            "tracker",
            outputs,
            inputs,
            node_name,
            common | own,
        )

    if config.one_process:
        return [spec("trackers", "tracker_container", "trackers", config.satellites)]
    return [
        spec(f"trackers_{s.lower()}", "tracker", f"trackers_{s.lower()}", (s,))
        for s in config.satellites
    ]


def _witnesses(config: GraphConfig) -> tuple[str, ...]:
    """Return the topics that precise positions wait for."""
    motion = ["motion/state"] * (config.aiding == "fusion")
    return (*motion, *(["base/observations", "base/reference"] * config.base))


def precise_parameters(config: GraphConfig) -> dict[str, Any]:
    """Return what pvt's precise positions have to know of the rest of the graph.

    What goes into the fusion that aids the loops must not be what the loops make of that aiding:
    each integration's own phase is taken, with the noise bandwidth of an integration.
    """
    tracker = config.parameters.get("tracker", {})
    name, default = ("aided", 8.0) if config.aiding else ("pll", 15.0)
    bandwidth_hz = float(tracker.get(f"{name}_bandwidth_hz", default))
    base = {"wait_base": config.base, "rtk_bandwidth_hz": bandwidth_hz}
    if "fallback_bandwidth_hz" in tracker:
        base["fallback_bandwidth_hz"] = float(tracker["fallback_bandwidth_hz"])
    if config.aiding == "fusion":
        integration_ms = float(tracker.get("integration_ms", 20))
        return {
            "loop_bandwidth_hz": 500.0 / integration_ms,
            "own_bandwidth_hz": bandwidth_hz,
            "wait_motion": True,
            "add_discriminator": True,
            **_witness(config),
            **base,
        }
    return {"loop_bandwidth_hz": bandwidth_hz, "wait_motion": False, **base}


def _witness(config: GraphConfig) -> dict[str, float]:
    """Return how good the IMU is that tells pvt of motion."""
    grade = config.parameters.get("fusion", {}).get("imu_grade", "")
    return {"imu_walk": grade_named(grade).accelerometers.walk} if grade else {}


def topic_type(topic: str) -> tuple[str, str]:
    """Type and quality of service of a topic."""
    if topic.startswith("tracking/"):
        return TYPES["tracking/<sat>/epochs"]
    return TYPES[topic]


def build_graph(config: GraphConfig) -> list[NodeSpec]:
    """Describe every process of the graph, with all its parameters.

    Parameters
    ----------
    config : GraphConfig
        What to run.

    Returns
    -------
    list of NodeSpec
        In the order in which they are to be started; the source is the last.
    """
    satellites = list(config.satellites)
    trackers = _trackers(config)
    tracker_names = [spec.name for spec in trackers]
    nodes = [
        NodeSpec(
            "acquisition",
            "deepseis_tracking",
            "acquisition",
            "acquisition",
            ("acquisition/result", "/diagnostics"),
            ("if/samples", "acquisition/request"),
            "acquisition",
            {"satellites": satellites, "trackers": tracker_names},
        ),
        *trackers,
        NodeSpec(
            "pvt",
            "deepseis_pvt",
            "pvt",
            "pvt",
            (
                *("gnss/observations", "gnss/pvt", "gnss/fix", "gnss/time_reference"),
                "gnss/precise",
                *(["gnss/rtk"] * config.base),
                "/diagnostics",
            ),
            (*_epoch_topics(config.satellites), "gnss/ephemeris", *_witnesses(config)),
            "pvt",
            {
                "satellites": satellites,
                "trackers": tracker_names,
                "sample_rate_hz": config.sample_rate_hz,
                "output_dir": config.output_dir,
                **precise_parameters(config),
            },
        ),
    ]
    if config.aiding == "truth":
        nodes.append(_truth_aiding(config))
    if config.aiding == "fusion":
        nodes += _inertial(config)
    if config.base:
        nodes.append(_base(config))
    source = NodeSpec(
        "if_source",
        "deepseis_frontend",
        "if_source",
        "if_source",
        ("if/samples", "/diagnostics"),
        (),
        "if_source",
        dict(config.source),
    )
    if config.record_dir:
        nodes.append(_recorder(config, [*nodes, source]))
    members = [spec.name for spec in nodes]
    onlookers = {"onlookers": [ONLOOKER]} if config.watched else {}
    nodes.append(_with(source, {"members": members, **onlookers}))
    return [_finish(spec, nodes, config) for spec in nodes]


def _truth_aiding(config: GraphConfig) -> NodeSpec:
    """Return the bench's aiding; its files are overrides (``parameters["truth_aiding"]``)."""
    source = config.source
    parameters: dict[str, Any] = {
        "satellites": list(config.satellites),
        "sample_rate_hz": config.sample_rate_hz,
    }
    parameters |= {key: source[key] for key in ("start_s", "start_utc") if source.get(key)}
    return NodeSpec(
        "truth_aiding",
        "deepseis_ins",
        "truth_aiding",
        "truth_aiding",
        ("aiding/doppler", "/diagnostics"),
        (),
        "truth_aiding",
        parameters,
    )


def _inertial(config: GraphConfig) -> list[NodeSpec]:
    """Return the inertial half: the IMU, still or moving, fusion."""
    imu_source = NodeSpec(
        "imu_source",
        "deepseis_frontend",
        "imu_source",
        "imu_source",
        ("imu/data_raw", "station", "/diagnostics"),
        (),
        "imu_source",
        {"file": config.source["file"], "imu_file": config.imu_file},
    )
    motion_state = NodeSpec(
        "motion_state",
        "deepseis_ins",
        "motion_state",
        "motion_state",
        ("motion/state", "/diagnostics"),
        ("imu/data_raw",),
        "motion_state",
        {"sample_rate_hz": config.sample_rate_hz},
    )
    fusion = NodeSpec(
        "fusion",
        "deepseis_ins",
        "fusion",
        "fusion",
        (
            *("aiding/doppler", "ins/solution", "ins/odometry", "seismo/displacement"),
            "/diagnostics",
        ),
        (
            *("imu/data_raw", "motion/state", "gnss/pvt", "gnss/precise", "gnss/ephemeris"),
            *(["gnss/rtk"] * config.base),
            *INPUTS_OF_COUPLINGS.get(config.coupling, ()),
        ),
        "fusion",
        {
            "satellites": list(config.satellites),
            "sample_rate_hz": config.sample_rate_hz,
            "wait_rtk": config.base,
        },
    )
    events = NodeSpec(
        "seismic_event",
        "deepseis_ins",
        "seismic_event",
        "seismic_event",
        ("seismo/event", "/diagnostics"),
        ("seismo/displacement",),
        "seismic_event",
        {"sample_rate_hz": config.sample_rate_hz},
    )
    ldv = [_velocimeter(config)] if config.coupling == "ldv" else []
    return [imu_source, *ldv, motion_state, fusion, events]


def _velocimeter(config: GraphConfig) -> NodeSpec:
    file = str(config.source["file"])
    if not is_bag(Path(file)):
        reason = f"takes the velocimeter from the source's bag, and {file or 'the source'} is none"
        raise InputError("coupling ldv", reason, "a bag that holds ldv/velocity")
    return NodeSpec(
        "ldv_source",
        "deepseis_frontend",
        "ldv_source",
        "ldv_source",
        ("ldv/velocity", "/diagnostics"),
        (),
        "ldv_source",
        {"file": file},
    )


def _base(config: GraphConfig) -> NodeSpec:
    return NodeSpec(
        "base_source",
        "deepseis_frontend",
        "base_source",
        "base_source",
        ("base/observations", "base/reference", "/diagnostics"),
        (),
        "base_source",
        {"file": config.source["file"], "base": config.base_from},
    )


def _recorder(config: GraphConfig, others: list[NodeSpec]) -> NodeSpec:
    topics = sorted({topic for spec in others for topic in spec.publishes})
    if not config.record_if:
        topics.remove("if/samples")
    entries = [
        " ".join((topic, *topic_type(topic), *(["shared"] * (topic in SHARED_TOPICS))))
        for topic in topics
    ]
    return NodeSpec(
        "recorder",
        "deepseis_bringup",
        "recorder",
        "recorder",
        (),
        tuple(topics),
        "recorder",
        {
            "directory": config.record_dir,
            "topics": entries,
            "members": [spec.name for spec in others if spec.name != "if_source"],
        },
    )


def _with(spec: NodeSpec, extra: Mapping[str, Any]) -> NodeSpec:
    return replace(spec, parameters={**spec.parameters, **extra})


def _finish(spec: NodeSpec, nodes: list[NodeSpec], config: GraphConfig) -> NodeSpec:
    """Add what follows from the graph as a whole: mode, expected subscribers, overrides."""
    expected = []
    for topic in spec.publishes:
        count = sum(topic in other.subscribes for other in nodes)
        if count:
            expected.append(f"{topic}={count}")
    extra: dict[str, Any] = {"mode": config.mode, "expected_subscribers": expected}
    if config.mode == "lockstep" and config.misses.get(spec.name):
        extra["misses"] = list(config.misses[spec.name])
    extra["flow_stride_ms"] = 0 if config.aiding or config.mode == "realtime" else 100
    return _with(spec, extra | dict(config.parameters.get(spec.kind, {})))
