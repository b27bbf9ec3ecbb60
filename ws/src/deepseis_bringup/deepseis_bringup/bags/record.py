"""Records the topics of a graph that runs already."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from deepseis_bringup.bags.mcap_recording import METADATA
from deepseis_bringup.graph import TYPES, NodeSpec
from deepseis_bringup.station import terminate_is_interrupt
from deepseis_bringup.supervisor import Supervisor, running
from deepseis_bringup.watch import GraphWatch
from deepseis_core.errors import InputError

WAIT_SECONDS = 5.0
"""How long to look for a first topic, and for who publishes the last ones [s]."""
SETTLE_SECONDS = 1.0
"""A graph is known once nothing new has appeared for so long [s]."""


def known_topic(name: str, station: str | None = None) -> str | None:
    """Return the entry of `graph.TYPES` that a topic's full name is, if any.

    Parameters
    ----------
    name : str
        Full name.
    station : str, optional
        Only topics in this namespace, and those that all stations share; None: in any.

    Examples
    --------
    >>> known_topic("/DSEI/tracking/G05/epochs")
    'tracking/<sat>/epochs'
    >>> known_topic("/DSEI/gnss/pvt", station="OTHER") is None
    True
    """
    namespace = r"(/\w+)*" if station is None else re.escape(f"/{station}" if station else "")
    for entry in TYPES:
        if entry.startswith("/"):
            pattern = re.escape(entry)
        else:
            pattern = f"{namespace}/" + re.escape(entry).replace("<sat>", r"[A-Z]\d\d")
        if re.fullmatch(pattern, name):
            return entry
    return None


def topics_seen(watch: GraphWatch, station: str | None) -> tuple[dict[str, str], bool]:
    """Return full names of the topics that somebody publishes, with their entries in `TYPES`.

    The second value tells whether there is a topic that is only subscribed to: then a part of
    the graph has not been discovered yet.
    """
    found: dict[str, str] = {}
    waiting = False
    for name, types in watch.node.get_topic_names_and_types():
        entry = known_topic(name, station)
        if not entry or TYPES[entry][0] not in types:
            continue
        if watch.node.count_publishers(name):
            found[name] = entry
        else:
            waiting = True
    return found, waiting


def find_topics(watch: GraphWatch, station: str | None) -> dict[str, str]:
    """Look at the graph until it is known.

    Raises
    ------
    InputError
        Nobody publishes anything.
    """
    found: dict[str, str] = {}
    deadline = limit = time.monotonic() + WAIT_SECONDS
    while time.monotonic() < deadline:
        watch.poll()
        now, waiting = topics_seen(watch, station)
        if now.keys() - found.keys():
            found = now
            deadline = time.monotonic() + SETTLE_SECONDS
            limit = time.monotonic() + WAIT_SECONDS
        if waiting and time.monotonic() < limit:
            deadline = time.monotonic() + SETTLE_SECONDS
        time.sleep(0.05)
    if not any(not entry.startswith("/") for entry in found.values()):
        domain = os.environ.get("ROS_DOMAIN_ID") or "0"
        whose = f" of station {station}" if station else ""
        raise InputError(
            f"ROS domain {domain}",
            f"nobody publishes a DeepSeis topic{whose} there",
            "start a station first; demo, replay and process keep to a domain of their own",
        )
    return found


def recorder_spec(topics: dict[str, str], directory: Path) -> NodeSpec:
    """Describe a recorder that takes no part in the graph's flow control."""
    entries = [" ".join((name, *TYPES[topics[name]])) for name in sorted(topics)]
    name = f"record_{os.getpid()}"
    parameters: dict[str, Any] = {"directory": str(directory.resolve()), "topics": entries}
    parameters["mode"] = "realtime"  # waits for room on a full disk
    return NodeSpec(
        name="recorder",
        package="deepseis_bringup",
        executable="recorder",
        kind="recorder",
        publishes=(),
        subscribes=tuple(topics),
        node_name=name,
        parameters=parameters,
        more_remaps=(f"flow/recorder:={name}/flow",),
    )


def is_subscribed(watch: GraphWatch, spec: NodeSpec) -> bool:
    """Tell whether a recorder has subscribed to all its topics."""
    return all(
        any(
            info.node_name == spec.node_name
            for info in watch.node.get_subscriptions_info_by_topic(topic)
        )
        for topic in spec.subscribes
    )


def record(
    folder: Path,
    *,
    station: str | None,
    say: Callable[[str], None],
    show: Callable[[str], None] = lambda _line: None,
    duration: float = 0.0,
) -> int:
    """Record until interrupted or for ``duration`` seconds; returns the number of messages.

    Raises
    ------
    InputError
        There is nothing to record, or the recorder failed.
    """
    bag = folder / "bag"
    with terminate_is_interrupt(), GraphWatch({}) as watch:
        topics = find_topics(watch, station)
        spec = recorder_spec(topics, bag)
        supervisor = Supervisor([spec], folder)
        with running(supervisor):
            started = 0.0

            def poll() -> None:
                nonlocal started
                if not started and is_subscribed(watch, spec):
                    say(f"recording {len(topics)} topics to {bag}")
                    started = time.monotonic()
                past = time.monotonic() - started if started else 0.0
                size = sum(path.stat().st_size for path in bag.glob("*.mcap")) / 1e6
                show(f"{past:.0f} s, {size:.1f} MB")
                if duration and past > duration:
                    raise KeyboardInterrupt
                time.sleep(0.1)

            try:
                supervisor.wait("recorder", poll=poll)
            except KeyboardInterrupt:
                say("stopping")
    supervisor.raise_failure()
    facts = yaml.safe_load((bag / METADATA).read_text(encoding="utf-8"))
    return int(facts["rosbag2_bagfile_information"]["message_count"])
