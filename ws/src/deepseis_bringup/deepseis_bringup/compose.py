"""Writes ``docker/compose.yaml`` from the graph's description: one service for each process.

python3 -m deepseis_bringup.compose [docker]
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from deepseis_bringup.graph import NodeSpec, build_graph
from deepseis_bringup.runs import graph_config
from deepseis_bringup.station_config import StationConfig, read_station_config
from deepseis_core.errors import InputError
from deepseis_core.if_format import IfFormat
from deepseis_core.types import IfBlock
from deepseis_frontend.if_stream import Remark

INSTALL = "/deepseis/install"
OUTPUT = "/output"
PARAMETERS = "/parameters"
HEADER = """\
# One service for each process of the graph. Made by `python3 -m deepseis_bringup.compose` from
# station.yaml and the graph's description; a test compares. See README.md for how to run it.
"""


@dataclass
class _Declared:
    """A recording that is not here: what the configuration says of it."""

    format: IfFormat
    sample_rate_hz: float
    intermediate_frequency_hz: float
    start_utc_ns: int | None = None
    total_samples: int | None = None
    first_sample: int = 0
    remarks: tuple[Remark, ...] = ()

    def blocks(self) -> Iterator[IfBlock]:
        """Yield nothing."""
        yield from ()


def container_graph(config: StationConfig) -> list[NodeSpec]:
    """Return the processes with the files where the containers see them.

    Raises
    ------
    InputError
        The configuration does not tell the packing and the rate.
    """
    chosen = config.selection
    if not (chosen.format and chosen.sample_rate_hz and chosen.start_utc):
        raise InputError("source", "has no format, sample_rate_hz or start_utc")
    source: Any = _Declared(
        IfFormat.from_text(chosen.format), chosen.sample_rate_hz, chosen.intermediate_frequency_hz
    )
    return build_graph(graph_config(chosen, source, Path(OUTPUT), config.options))


def service(spec: NodeSpec, station: str) -> dict[str, Any]:
    """Return one service.

    The executable itself is started: `ros2 run` would keep the signal to stop to itself.
    """
    rules = [word for rule in spec.remaps() for word in ("-r", rule)]
    namespace = ["-r", f"__ns:=/{station}"] if station else []
    return {
        "image": "deepseis",
        "build": {"context": "..", "dockerfile": "docker/Dockerfile"},
        "command": [
            f"{INSTALL}/{spec.package}/lib/{spec.package}/{spec.executable}",
            "--ros-args",
            "--params-file",
            f"{PARAMETERS}/{spec.name}.yaml",
            *rules,
            *namespace,
        ],
        "network_mode": "host",
        "ipc": "host",
        "environment": {"ROS_DOMAIN_ID": "${ROS_DOMAIN_ID:-0}"},
        "volumes": [
            f"./parameters:{PARAMETERS}:ro",
            "${DEEPSEIS_INPUT:-../runs/input}:/input:ro",
            f"${{DEEPSEIS_OUTPUT:-../runs/container}}:{OUTPUT}",
        ],
        "stop_signal": "SIGINT",
        "stop_grace_period": "30s",
    }


def compose_files(config: StationConfig) -> dict[str, str]:
    """Return the files for the containers, by name."""
    specs = container_graph(config)
    services = {spec.name: service(spec, config.station) for spec in specs}
    body = yaml.dump({"name": "deepseis", "services": services}, sort_keys=False, width=99)
    files = {"compose.yaml": HEADER + body}
    for spec in specs:
        values = {"/**": {"ros__parameters": spec.ros_parameters()}}
        files[f"parameters/{spec.name}.yaml"] = yaml.safe_dump(values, width=99)
    return files


def main() -> None:
    """Write the files."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "docker")
    try:
        files = compose_files(read_station_config(folder / "station.yaml"))
    except InputError as error:
        sys.exit(f"compose: {error}")
    for path in (folder / "parameters").glob("*.yaml"):
        path.unlink()
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
        print(path)


if __name__ == "__main__":
    main()
