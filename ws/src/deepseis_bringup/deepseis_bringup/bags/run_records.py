"""What a bag says of its own making: input, versions, parameters, graph. Nothing of when or where.

Metadata records of the bag, so the same input gives the same records. A replay takes the
satellites and the parameters that shape the result from here.
"""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import Any

from deepseis_bringup.graph import GraphConfig, NodeSpec, build_graph
from deepseis_bringup.inertial import TOLD_BY_SOURCE
from deepseis_core.errors import InputError
from deepseis_core.mcap_scan import McapScan
from deepseis_frontend.if_bag import bag_files, mcap_files
from deepseis_frontend.ntrip import is_address

PLACES = frozenset({"directory", "output_dir", "records"})
"""Parameters that tell where a run went, not what came out."""

SHAPING = ("acquisition", "tracker", "pvt")
INERTIAL = ("motion_state", "fusion", "seismic_event")
"""Kinds of nodes whose parameters shape the result of a replay; of the inertial ones without what
the replay finds in the recording."""

VERSIONS = ("numpy", "numba", "scipy", "rclpy", "mcap")


def versions() -> dict[str, str]:
    """Return versions of what shapes the result."""
    found = {}
    for name in VERSIONS:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "unknown"
    return found


def input_hash(path: Path) -> str:
    """SHA-256 over a file, or over the files of a bag's folder in order of name."""
    digest = hashlib.sha256()
    files = mcap_files(path) if path.is_dir() else [path]
    for file in files:
        with file.open("rb") as stream:
            while piece := stream.read(1 << 22):
                digest.update(piece)
    return digest.hexdigest()


def with_records(config: GraphConfig, sha256: str) -> GraphConfig:
    """Return the graph whose recorder puts the run's records into the bag."""
    records = run_records(config, build_graph(config), sha256)
    given = dict(config.parameters.get("recorder", {}))
    recorder = {"records": json.dumps(records, sort_keys=True), **given}
    return replace(config, parameters={**config.parameters, "recorder": recorder})


def run_records(
    config: GraphConfig, specs: Sequence[NodeSpec], sha256: str
) -> dict[str, dict[str, str]]:
    """Return the metadata records of a run's bag."""
    return {
        "input": {"sha256": sha256, **_texts(_without_places(config.source))},
        "versions": {"python": platform.python_version(), **versions()},
        "run": {
            "satellites": " ".join(config.satellites),
            "mode": config.mode,
            "one_process": str(config.one_process),
            "aiding": config.aiding,
            "parameters": _json(_shaping(config.parameters)),
        },
        "parameters": {s.name: _json(_without_places(s.parameters)) for s in specs},
        "graph": {s.name: _json(_place_in_graph(s)) for s in specs},
    }


def _shaping(parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    inertial = {
        kind: {k: v for k, v in parameters.get(kind, {}).items() if k not in TOLD_BY_SOURCE}
        for kind in INERTIAL
    }
    return {kind: dict(parameters.get(kind, {})) for kind in SHAPING} | inertial


def _place_in_graph(spec: NodeSpec) -> dict[str, Any]:
    return {
        "package": spec.package,
        "executable": spec.executable,
        "publishes": spec.publishes,
        "subscribes": spec.subscribes,
    }


def _without_places(parameters: Mapping[str, Any]) -> dict[str, Any]:
    kept = {name: value for name, value in parameters.items() if name not in PLACES}
    for name in ("file", "imu_file", "base"):
        if kept.get(name) and not is_address(str(kept[name])):
            kept[name] = Path(kept[name]).name
    return kept


def _texts(values: Mapping[str, Any]) -> dict[str, str]:
    return {name: str(value) for name, value in values.items()}


def _json(value: Any) -> str:
    return json.dumps(value, sort_keys=True)


@dataclass(frozen=True)
class RecordedRun:
    """What a replay takes over from the run that was recorded."""

    satellites: tuple[str, ...] = ()
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def recorded_run(bag: Path) -> RecordedRun:
    """Read a bag's record of its run; empty if it has none.

    Raises
    ------
    InputError
        Where there is no bag, or its record cannot be understood.
    """
    files = bag_files(bag)
    scan = McapScan(files[0], tolerant=True)
    next(scan.messages(), None)  # metadata comes first
    found = scan.metadata.get("run", {})
    try:
        parameters = json.loads(found.get("parameters", "{}"))
    except (ValueError, RecursionError):
        raise InputError(files[0], "has an unreadable record of its run") from None
    by_kind = isinstance(parameters, dict) and parameters.values()
    if by_kind is False or not all(isinstance(values, dict) for values in by_kind):
        raise InputError(files[0], "has a record of its run that names no parameters by kind")
    return RecordedRun(tuple(found.get("satellites", "").split()), parameters)
