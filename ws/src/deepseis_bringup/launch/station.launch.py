"""Launch a station in a ROS 2 Jazzy installation: the same graph as `deepseis station`.

    ros2 launch deepseis_bringup station.launch.py config:=station.yaml output:=/data/run1

Every process gets the executable, parameters, names and namespace that
`deepseis_bringup.graph` describes; the parameters lie in ``<output>/parameters``. The launch ends
with the source, or with the first node that ends before it.
"""

from datetime import UTC, datetime
from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    """Declare the arguments; the nodes follow once these are known."""
    example = Path(__file__).resolve().parent.parent / "config" / "station.yaml"
    folder = Path("runs") / datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "config", default_value=str(example), description="Configuration [YAML]."
            ),
            DeclareLaunchArgument(
                "output", default_value=str(folder), description="Run folder, made new."
            ),
            DeclareLaunchArgument(
                "coupling",
                default_value="",
                description="Of the fusion: loose, tight or ldv; empty: as configured.",
            ),
            OpaqueFunction(function=station_nodes),
        ]
    )


def station_nodes(context):
    """Return one action for each process of the graph."""
    from dataclasses import replace

    from deepseis_bringup.commands.runs import coupled
    from deepseis_bringup.graph import build_graph
    from deepseis_bringup.live.live_page import page_spec
    from deepseis_bringup.run_folder import new_run_folder
    from deepseis_bringup.station_config import read_station_config
    from deepseis_bringup.supervisor import parameter_file

    config = read_station_config(LaunchConfiguration("config").perform(context))
    coupling = LaunchConfiguration("coupling").perform(context)
    config = replace(config, parameters=coupled(config.parameters, coupling))
    folder = new_run_folder(Path(LaunchConfiguration("output").perform(context))).resolve()
    graph = config.graph(folder)
    specs = build_graph(graph)
    (folder / "parameters").mkdir(parents=True)

    def node(spec, **how):
        return Node(
            package=spec.package,
            executable=spec.executable,
            namespace=config.station or None,
            # No name=: it would rename every node of a process, the satellites' too.
            arguments=node_arguments(spec),
            parameters=[str(parameter_file(spec, folder / "parameters"))],
            output="screen",
            **how,
        )

    page = config.live_page
    looking_on = [node(page_spec(page), respawn=True, respawn_delay=5.0)] if page else []
    ending = [node(spec, on_exit=[Shutdown(reason=f"{spec.name} has ended")]) for spec in specs]
    frames = frame_publishers(graph.parameters.get("fusion", {}), config.station)
    return [*looking_on, *frames, *ending]


def frame_publishers(fusion, station):
    """Return what publishes the station's static frames on its own tf_static, if tf2 is there."""
    from ament_index_python.packages import PackageNotFoundError, get_package_prefix

    from deepseis_bringup.frames import static_transforms

    try:
        get_package_prefix("tf2_ros")
    except PackageNotFoundError:
        return []
    return [
        Node(
            package="tf2_ros",
            executable="static_transform_publisher",
            namespace=station or None,
            arguments=frame.arguments(),
            remappings=[("/tf_static", "tf_static")],
        )
        for frame in static_transforms(fusion)
    ]


def node_arguments(spec):
    """Return the remapping rules of a process as arguments."""
    rules = [word for rule in spec.remaps() for word in ("-r", rule)]
    return ["--ros-args", *rules, "--"] if rules else []
