"""Process: one satellite's tracker node on its own; parameter ``satellite`` names it."""

from __future__ import annotations

from dataclasses import dataclass

from rclpy.node import Node

from deepseis_core.config import setting
from deepseis_core.ros.main import Process, run
from deepseis_core.ros.parameters import declare
from deepseis_tracking.nodes.tracker_host import TrackerHost


@dataclass(frozen=True)
class TrackerConfig:
    """Whom this process tracks."""

    satellite: str = setting("G01", "satellite to track, RINEX name [-]")


def main() -> None:
    """Run the node."""

    def build(process: Process) -> None:
        node = Node("tracker")
        process.add(node)
        TrackerHost(process, node, [declare(node, TrackerConfig).satellite])

    run(build, "tracker")


if __name__ == "__main__":
    main()
