"""Runs a graph over DDS without a page or a bar, and gives what it recorded."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from pathlib import Path

from deepseis_bringup.graph import GraphConfig, build_graph
from deepseis_bringup.supervisor import Supervisor, own_domain, running
from deepseis_bringup.watch import GraphWatch
from deepseis_core.mcap_scan import McapScan
from deepseis_frontend.if_bag import mcap_files


def run_graph(config: GraphConfig, folder: Path, *, namespace: str = "") -> dict[str, list[bytes]]:
    """Run a graph in lockstep, all but the samples recorded.

    Parameters
    ----------
    config : GraphConfig
        What to run; where it records is set here.
    folder : Path
        Made new; gets the bag.
    namespace : str
        The station's name, or empty.

    Returns
    -------
    dict
        Payloads of every topic, without the leading slash, in the order of the bag.

    Raises
    ------
    InputError
        A node failed, or the graph stands still.
    """
    folder.mkdir(parents=True)
    here = replace(
        config,
        record_dir=str(folder / "bag"),
        record_if=False,
        output_dir=str(folder),
        watched=True,
    )
    with own_domain() as environment:
        supervisor = Supervisor(
            build_graph(here), folder, namespace=namespace, environment=environment
        )
        members = [spec.name for spec in supervisor.specs if spec.name != "if_source"]
        with (
            running(supervisor),
            GraphWatch(environment, namespace, members=members) as watch,
        ):

            def poll() -> None:
                watch.poll()
                watch.require_progress()

            supervisor.wait(poll=poll)
    found: dict[str, list[bytes]] = defaultdict(list)
    for path in mcap_files(folder / "bag"):
        for message in McapScan(path).messages():
            found[message.channel.topic.lstrip("/")].append(bytes(message.data))
    return dict(found)
