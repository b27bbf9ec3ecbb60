"""Runs of the graph for tests: short recordings, bags as bytes, RINEX without dates."""

from __future__ import annotations

import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepseis_bringup.runs import RunOptions, Selection, run_recording
from deepseis_core.mcap_scan import McapScan
from deepseis_core.ros.cdr import message_class
from deepseis_sim.recording import SimulatedRecording
from deepseis_sim.still_recording import StillConfig, simulate_still

PROJECT = Path(__file__).resolve().parent.parent
RATE = 4e6
DURATION = 28.0
"""First fix after 20 s, ionosphere parameters after 26 s (page 18 is in the second frame)."""
ABSENT = "G05"
"""A satellite that is searched for and is not there."""


def recording(folder: Path, duration: float, **settings: Any) -> SimulatedRecording:
    """Six satellites above 20 deg, from 2 s before a subframe 1; a fix takes 20 s."""
    config = StillConfig(**{"duration": duration, "elevation_mask_deg": 20.0, **settings})
    return simulate_still(config, folder)


def assistance(recording: SimulatedRecording) -> dict[str, dict[str, Any]]:
    """Parameters of a station that knows its position and the orbits.

    With nine satellites it has a fix after 1.4 s, with five after the first subframe (8.1 s).
    """
    position = np.load(recording.truth_path)["antenna_ecef"][0].tolist()
    known = {"nav_file": str(recording.nav_path), "position_ecef": position}
    return {"pvt": known, "acquisition": known}


@dataclass(frozen=True)
class Run:
    """A run folder and the figures of its run."""

    folder: Path
    figures: Mapping[str, Any]

    @property
    def bag(self) -> Path:
        return self.folder / "bag"

    def payloads(self, *, tolerant: bool = False) -> dict[str, list[bytes]]:
        """Messages of every topic, as recorded."""
        return payloads(self.bag, tolerant=tolerant)

    def statuses(self) -> dict[str, list[tuple[int, str, dict[str, str]]]]:
        """Level, text and values of the diagnostics of every node."""
        found = defaultdict(list)
        for data in self.payloads()["/diagnostics"]:
            for item in decode("diagnostic_msgs/msg/DiagnosticArray", data).status:
                values = {pair.key: pair.value for pair in item.values}
                found[item.hardware_id].append((item.level[0], item.message, values))
        return found

    def rinex(self) -> dict[str, list[str]]:
        """RINEX files of the run by name, without the line that says when they were written."""
        return {
            path.name: [line for line in path.read_text().splitlines() if "PGM / RUN" not in line]
            for path in self.folder.glob("*.rnx")
        }


def run(source: Path, folder: Path, satellites: Sequence[str], **options: Any) -> Run:
    """Run the graph on a recording; what is no option of a run selects the recording."""
    selection = {
        name: options.pop(name)
        for name in ("format", "sample_rate_hz", "start_utc", "length_s")
        if name in options
    }
    folder.mkdir(parents=True, exist_ok=True)
    options = {"timeout": 50.0, **options}
    given = RunOptions(satellites=tuple(satellites), **options)
    figures = run_recording(Selection(str(source), **selection), folder, given, progress=False)
    return Run(folder, figures)


def payloads(bag: Path, *, tolerant: bool = False) -> dict[str, list[bytes]]:
    found = defaultdict(list)
    for path in [bag] if bag.is_file() else sorted(bag.glob("*.mcap")):
        for message in McapScan(path, tolerant=tolerant).messages():
            found[message.channel.topic].append(bytes(message.data))
    return found


def decode(type_name: str, data: bytes) -> Any:
    from rclpy.serialization import deserialize_message

    return deserialize_message(data, message_class(type_name))


@contextmanager
def busy_machine(processes: int = 2) -> Iterator[None]:
    """Keep the processors busy for the while."""
    command = [sys.executable, "-c", "while True: pass"]
    started = [subprocess.Popen(command) for _ in range(processes)]
    try:
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


def command(*arguments: object, timeout: float = 50.0) -> subprocess.CompletedProcess[str]:
    """Run ``./deepseis`` as a user does."""
    return subprocess.run(
        [str(PROJECT / "deepseis"), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=timeout,
        cwd=PROJECT,
    )
