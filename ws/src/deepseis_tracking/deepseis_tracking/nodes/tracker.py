"""Process: one satellite's tracker node on its own; parameter ``satellite`` names it."""

from rclpy.node import Node

from deepseis_core.ros.main import Process, run
from deepseis_tracking.nodes.tracker_host import TrackerHost


def main() -> None:
    """Run the node."""

    def build(process: Process) -> None:
        node = Node("tracker")
        satellite = node.declare_parameter("satellite", "G01").value
        process.add(node)
        TrackerHost(process, node, [satellite])

    run(build, "tracker")


if __name__ == "__main__":
    main()
