"""What docker/ says against the graph's description and the lock file; no engine is needed."""

import re
from pathlib import Path

import pytest
import yaml

from deepseis_bringup.compose import compose_files, container_graph
from deepseis_bringup.station_config import read_station_config

ROOT = Path(__file__).resolve().parents[3]
DOCKER = ROOT / "docker"
CONFIG = read_station_config(DOCKER / "station.yaml")
COMPOSE = yaml.safe_load((DOCKER / "compose.yaml").read_text())
SPECS = {spec.name: spec for spec in container_graph(CONFIG)}
STAGES = ["base", "deps", "build", "test"]


def test_there_is_one_service_for_each_process():
    assert list(COMPOSE["services"]) == list(SPECS)
    assert {"if_source", "acquisition", "trackers", "pvt", "recorder"} == set(SPECS)


@pytest.mark.parametrize("name", SPECS)
def test_a_service_starts_its_process_with_its_parameters(name):
    service, spec = COMPOSE["services"][name], SPECS[name]
    executable, *arguments = service["command"]
    assert executable.split("/")[-4:] == [spec.package, "lib", spec.package, spec.executable]
    assert arguments[:3] == ["--ros-args", "--params-file", f"/parameters/{name}.yaml"]
    rules = [word for word in arguments[3:] if word != "-r"]
    assert rules == [*spec.remaps(), f"__ns:=/{CONFIG.station}"]
    given = yaml.safe_load((DOCKER / f"parameters/{name}.yaml").read_text())
    assert given == {"/**": {"ros__parameters": spec.ros_parameters()}}


@pytest.mark.parametrize("name", SPECS)
def test_services_share_memory_and_are_stopped_as_by_ctrl_c(name):
    service = COMPOSE["services"][name]
    assert (service["network_mode"], service["ipc"]) == ("host", "host")
    assert service["stop_signal"] == "SIGINT"


def test_services_see_the_files_that_the_parameters_name():
    targets = {
        volume.split(":")[-2 if volume.endswith(":ro") else -1]
        for service in COMPOSE["services"].values()
        for volume in service["volumes"]
    }
    assert targets == {"/parameters", "/input", "/output"}
    assert SPECS["if_source"].parameters["file"].startswith("/input/")
    assert SPECS["recorder"].parameters["directory"].startswith("/output/")
    assert SPECS["pvt"].parameters["output_dir"] == "/output"


def test_the_files_are_those_that_the_generator_writes():
    made = compose_files(CONFIG)
    there = {"compose.yaml", *(f"parameters/{p.name}" for p in (DOCKER / "parameters").iterdir())}
    assert there == set(made)
    for name, text in made.items():
        assert (DOCKER / name).read_text() == text, f"{name}: python3 -m deepseis_bringup.compose"


def names(requirements):
    return {line for line in requirements.read_text().splitlines() if not line.startswith("#")}


def test_every_requirement_is_pinned_by_the_lock_file():
    pins = {line.partition("==")[0] for line in names(ROOT / "requirements.lock")}
    assert names(DOCKER / "requirements.txt") <= pins
    assert names(DOCKER / "requirements-test.txt") <= pins


def test_the_image_has_all_that_the_packages_import():
    required = names(DOCKER / "requirements.txt")
    imported = set()
    for path in (ROOT / "ws/src").glob("*/deepseis_*/**/*.py"):
        found = re.findall(r"^\s*(?:import|from) (\w+)", path.read_text(), re.MULTILINE)
        imported |= set(found)
    assert required <= imported
    outside = {"lz4", "mcap", "mcap_ros2", "numba", "plotly", "pyrtklib", "rosbags", "typer"}
    assert imported & (outside | {"georinex", "zstandard"}) <= required


def test_the_stages_follow_each_other():
    text = (DOCKER / "Dockerfile").read_text()
    stages = re.findall(r"^FROM (\S+) AS (\S+)", text, re.MULTILINE)
    assert [name for _, name in stages] == STAGES
    assert [source for source, _ in stages] == ["ros:jazzy-ros-base", *STAGES[:-1]]
    assert text.rstrip().endswith("FROM build")


def test_what_the_dockerfile_copies_is_there():
    text = (DOCKER / "Dockerfile").read_text()
    for words in re.findall(r"^COPY (.+)$", text, re.MULTILINE):
        for source in words.split()[:-1]:
            assert (ROOT / source).exists(), source
    packages = sorted(path.parent.name for path in (ROOT / "ws/src").glob("*/package.xml"))
    assert sorted(re.findall(r"^COPY ws/src/(\w+)/package.xml", text, re.MULTILINE)) == packages
