"""Process: all satellites' tracker nodes together."""

from rclpy.node import Node

from deepseis_core.ros.main import Process, run
from deepseis_tracking.nodes.tracker_host import TrackerHost


def main() -> None:
    """Run the nodes."""

    def build(process: Process) -> None:
        node = Node("trackers")
        process.add(node)
        TrackerHost(process, node, None)

    run(build, "trackers")


if __name__ == "__main__":
    main()
