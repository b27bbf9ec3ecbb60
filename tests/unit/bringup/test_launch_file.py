"""The launch file against the graph's description; `launch` itself is not on the package index."""

import ast
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
import yaml

from deepseis_bringup.graph import build_graph
from deepseis_bringup.station_config import read_station_config
from deepseis_bringup.supervisor import Supervisor
from deepseis_core.errors import InputError

LAUNCH_FILE = (
    Path(__file__).resolve().parents[3] / "ws/src/deepseis_bringup/launch/station.launch.py"
)


class Action:
    """Keeps what it was made with."""

    def __init__(self, *given, **named):
        self.given, self.named = given, named


class Node(Action):
    """Takes only the keywords that `launch_ros.actions.Node` and what it is made of take."""

    KNOWN = frozenset(
        ("package", "executable", "name", "namespace", "parameters", "remappings", "arguments")
    ) | {"output", "on_exit"}

    def __init__(self, **named):
        assert named.keys() <= self.KNOWN
        super().__init__(**named)


class LaunchConfiguration:
    def __init__(self, name):
        self.name = name

    def perform(self, context):
        return context.launch_configurations[self.name]


@pytest.fixture
def launch_file(monkeypatch):
    """Load the file with the names that it takes from launch and launch_ros."""
    modules = {
        "launch": {"LaunchDescription": Action},
        "launch.actions": {
            name: type(name, (Action,), {})
            for name in ("DeclareLaunchArgument", "OpaqueFunction", "Shutdown")
        },
        "launch.substitutions": {"LaunchConfiguration": LaunchConfiguration},
        "launch_ros": {},
        "launch_ros.actions": {"Node": Node},
    }
    for name, contents in modules.items():
        module = ModuleType(name)
        vars(module).update(contents)
        monkeypatch.setitem(sys.modules, name, module)
    names = {"__file__": str(LAUNCH_FILE), "__name__": "station_launch"}
    exec(compile(LAUNCH_FILE.read_text(), LAUNCH_FILE, "exec"), names)
    return SimpleNamespace(**names)


def station_file(tmp_path, extra=""):
    recording = tmp_path / "if.bin"
    recording.write_bytes(bytes(range(64)) * 4000)
    Path(f"{recording}.yaml").write_text("format: iq8\nsample_rate_hz: 4e6\n")
    path = tmp_path / "station.yaml"
    path.write_text(f"source: {{file: if.bin}}\n{extra}")
    return path


def nodes_of(launch_file, config, output, coupling=""):
    description = launch_file.generate_launch_description()
    *arguments, opaque = description.given[0]
    assert [argument.given[0] for argument in arguments] == ["config", "output", "coupling"]
    given = {"config": str(config), "output": str(output), "coupling": coupling}
    context = SimpleNamespace(launch_configurations=given)
    return opaque.named["function"](context)


EXTRAS = {
    "plain": "",
    "named": "station: DSEI\nparameters: {tracker: {pll_bandwidth_hz: 9.5}, pvt: {rate_hz: 10}}\n",
    "separate": "one_process: false\nsatellites: [G05, G12]\nstation: A_1\n",
    "without_recorder": "record: false\nmode: lockstep\n",
}


@pytest.mark.parametrize("extra", EXTRAS.values(), ids=EXTRAS)
def test_every_process_is_that_of_the_graph(launch_file, tmp_path, extra):
    config = station_file(tmp_path, extra)
    nodes = nodes_of(launch_file, config, tmp_path / "run")
    settings = read_station_config(config)
    specs = build_graph(settings.graph(tmp_path / "run"))
    assert len(nodes) == len(specs)
    for node, spec in zip(nodes, specs, strict=True):
        named = node.named
        assert (named["package"], named["executable"]) == (spec.package, spec.executable)
        assert named["namespace"] == (settings.station or None)
        (path,) = named["parameters"]
        held = yaml.safe_load(Path(path).read_text())
        assert held == {"/**": {"ros__parameters": spec.ros_parameters()}}
        rules = [word for rule in spec.remaps() for word in ("-r", rule)]
        assert named["arguments"] == (["--ros-args", *rules, "--"] if rules else [])
        assert spec.name in named["on_exit"][0].named["reason"]


def test_a_coupling_given_to_the_launch_is_the_fusions(launch_file, tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr("deepseis_bringup.graph.build_graph", lambda c: seen.append(c) or [])
    config = station_file(tmp_path, "parameters: {fusion: {heading_sd_deg: 0.2}}\n")
    nodes_of(launch_file, config, tmp_path / "a", "tight")
    assert seen[-1].parameters["fusion"] == {"heading_sd_deg": 0.2, "coupling": "tight"}
    with pytest.raises(InputError, match="one of loose, tight, ldv"):
        nodes_of(launch_file, config, tmp_path / "b", "deep")


def test_processes_get_the_same_as_from_the_supervisor(launch_file, tmp_path, monkeypatch):
    config = station_file(tmp_path, EXTRAS["separate"])
    nodes = nodes_of(launch_file, config, tmp_path / "run")
    started = {}

    def popen(command, **_named):
        started[Path(command[0]).name, tuple(command[1:])] = command
        return SimpleNamespace(poll=lambda: 0)

    monkeypatch.setattr("deepseis_bringup.supervisor.subprocess.Popen", popen)
    monkeypatch.setattr(
        "deepseis_bringup.supervisor.executables.executable", lambda _package, node: Path(node)
    )
    settings = read_station_config(config)
    specs = build_graph(settings.graph(tmp_path / "run"))
    Supervisor(specs, tmp_path / "run", namespace=settings.station).start()
    for node in nodes:
        named = node.named
        rules = [word for word in named["arguments"] if word not in ("--ros-args", "--")]
        command = ["--ros-args", "--params-file", named["parameters"][0], *rules]
        command += ["-r", f"__ns:=/{named['namespace']}"]
        assert (named["executable"], tuple(command)) in started


def test_no_rule_renames_the_satellites_nodes(launch_file, tmp_path):
    nodes = nodes_of(launch_file, station_file(tmp_path, EXTRAS["separate"]), tmp_path / "run")
    for node in nodes:
        assert "name" not in node.named
        rules = [word for word in node.named["arguments"] if ":=" in word]
        assert all(not rule.startswith("__node") for rule in rules)
        if node.named["executable"] == "tracker":
            assert len(rules) == 1


def test_asking_for_the_arguments_imports_nothing_of_the_graph():
    top = ast.parse(LAUNCH_FILE.read_text()).body
    imported = {alias.name for node in top if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module for node in top if isinstance(node, ast.ImportFrom)}
    assert {name.partition(".")[0] for name in imported} == {
        *("datetime", "pathlib", "launch", "launch_ros")
    }


def test_the_default_configuration_is_the_example(launch_file):
    arguments = launch_file.generate_launch_description().given[0]
    path = Path(arguments[0].named["default_value"])
    assert path.name == "station.yaml"
    assert path.is_file()


def test_a_used_folder_is_refused(launch_file, tmp_path):
    config = station_file(tmp_path)
    nodes_of(launch_file, config, tmp_path / "run")
    with pytest.raises(InputError, match="is not empty"):
        nodes_of(launch_file, config, tmp_path / "run")
