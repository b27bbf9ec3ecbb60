"""What a recorded realtime run did not wait for: its replay does the same."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from deepseis_core.mcap_scan import Channel, McapScan
from deepseis_core.status_names import node_of
from deepseis_frontend.if_bag import bag_files

SUFFIX: Final = " misses"


@dataclass(frozen=True)
class RecordedMisses:
    """Misses of a run by flow member, and whether a replay can repeat the run at all.

    Attributes
    ----------
    by_member : mapping of str to tuple of str
        Entries for `deepseis_core.miss_log.MissScript`.
    one_process : bool
        Whether one process ran all trackers: their misses are its.
    restarts : int
        Nodes that were started again: what they began with is not repeated.
    """

    by_member: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    one_process: bool = True
    restarts: int = 0


def recorded_misses(bag: Path) -> RecordedMisses:
    """Read what a bag's nodes said of their misses; nothing, where it is no realtime run.

    Raises
    ------
    InputError
        There is no bag, or it cannot be read.
    """
    found: dict[str, list[str]] = defaultdict(list)
    restarts, run = 0, dict[str, str]()
    for file in bag_files(bag):
        scan = McapScan(file, tolerant=True)
        for message in scan.messages(_is_diagnostics):
            run = run or scan.metadata.get("run", {})
            if run.get("mode") == "lockstep":
                return _replayed(scan, run)
            for name, values in _statuses(bytes(message.data)):
                if name.endswith(SUFFIX):
                    member = name.removesuffix(SUFFIX)
                    found[member] += [f"{what} {runs}" for what, runs in values.items()]
                elif name == "supervisor":
                    restarts = max(restarts, int(values.get("restarts", 0)))
    misses = {name: tuple(entries) for name, entries in found.items()}
    return RecordedMisses(misses, run.get("one_process", "True") == "True", restarts)


def _replayed(scan: McapScan, run: Mapping[str, str]) -> RecordedMisses:
    """Return what a replay was itself given."""
    parameters = {n: json.loads(v) for n, v in scan.metadata.get("parameters", {}).items()}
    misses = {n: tuple(p["misses"]) for n, p in parameters.items() if p.get("misses")}
    return RecordedMisses(misses, run.get("one_process", "True") == "True")


def _is_diagnostics(channel: Channel) -> bool:
    return channel.topic == "/diagnostics"


def _statuses(data: bytes) -> list[tuple[str, dict[str, str]]]:
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.serialization import deserialize_message

    msg: Any = deserialize_message(data, DiagnosticArray)
    return [(node_of(s), {pair.key: pair.value for pair in s.values}) for s in msg.status]
