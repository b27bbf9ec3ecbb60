"""Starts the graph's processes, watches them, ends them in order."""

from __future__ import annotations

import ctypes
import os
import re
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from deepseis_bringup import executables
from deepseis_bringup.graph import NodeSpec
from deepseis_bringup.restarts import Restarts
from deepseis_core.errors import InputError

STOP_SECONDS = 20.0
"""Time a node has to finish its files after SIGINT [s]."""

CULPRIT_SECONDS = 5.0
"""Time for a node that has told the others that it gives up to end [s]."""

GAVE_UP = re.compile(r": (\w+) gave up: ")
"""What a node says as its last word that ends because of another (`deepseis_core.ros.flow`)."""

BAD_INPUT = 2
"""Exit status of a node that cannot use its input or parameters: no accident."""

_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)


def _die_with_parent() -> None:
    """Let no node outlive its supervisor, however that ends; runs in the child."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def parameter_file(spec: NodeSpec, folder: Path, **more: Any) -> Path:
    """Write a node's parameters as ROS reads them."""
    path = folder / f"{spec.name}.yaml"
    values = {"/**": {"ros__parameters": spec.ros_parameters() | more}}
    path.write_text(yaml.safe_dump(values, sort_keys=True))
    return path


def ending(status: int) -> str:
    """Say how a process ended."""
    return f"ended with status {status}" if status >= 0 else f"was killed by signal {-status}"


@dataclass
class Supervisor:
    """The processes of one graph.

    Parameters
    ----------
    specs : list of NodeSpec
        From `deepseis_bringup.graph.build_graph`.
    folder : Path
        For parameter files and logs.
    namespace : str
        The station's name, or empty.
    environment : mapping
        Added to the processes' environment, such as ROS_DOMAIN_ID.
    restarts : Restarts, optional
        Real time: who is started again when it has died. Without, a death ends the graph.
    """

    specs: list[NodeSpec]
    folder: Path
    namespace: str = ""
    environment: Mapping[str, str] = field(default_factory=dict)
    restarts: Restarts | None = None
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    stuck: dict[str, str] = field(default_factory=dict)

    def start(self) -> None:
        """Start every process.

        Raises
        ------
        InputError
            A node is not installed.
        """
        for name in ("parameters", "logs"):
            (self.folder / name).mkdir(parents=True, exist_ok=True)
        for spec in self.specs:
            self.processes[spec.name] = self._start(spec)

    def _start(self, spec: NodeSpec, **more: Any) -> subprocess.Popen[bytes]:
        parameters = parameter_file(spec, self.folder / "parameters", **more)
        try:
            path = executables.executable(spec.package, spec.executable)
        except executables.UnknownExecutableError as error:
            raise InputError(f"node {spec.name}", str(error)) from None
        arguments = ["--ros-args", "--params-file", str(parameters)]
        arguments += [word for rule in spec.remaps() for word in ("-r", rule)]
        if self.namespace:
            arguments += ["-r", f"__ns:=/{self.namespace}"]
        with self.log_of(spec.name).open("ab") as log:
            return subprocess.Popen(
                [str(path), *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=_die_with_parent,
                env={**os.environ, **self.environment},
            )

    def log_of(self, name: str) -> Path:
        """Return the file with what a node printed."""
        return self.folder / "logs" / f"{name}.log"

    def last_line(self, name: str) -> str:
        """Return the last thing a node printed."""
        lines = self.log_of(name).read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else "no message"

    def warnings(self, name: str) -> list[str]:
        """Return what a node has warned of."""
        lines = self.log_of(name).read_text(errors="replace").splitlines()
        return [line.partition("]: ")[2] for line in lines if line.startswith("[WARN]")]

    def failed(self) -> tuple[str, int] | None:
        """Name the first process that ended badly, with its status."""
        for name, status in self.statuses().items():
            if status not in (None, 0):
                return name, int(status)
        return None

    def tend(self, until: str) -> None:
        """Look who has died while ``until`` runs; start again whose turn it is.

        Raises
        ------
        InputError
            As `raise_failure`, where a death ends the graph.
        """
        restarts = self.restarts
        if restarts is None:
            self.raise_failure()
            return
        for name, process in self.processes.items():
            status = None if name == until or restarts.waits(name) else process.poll()
            if status is None:
                continue
            how = self.stuck.pop(name, ending(status))
            if status == BAD_INPUT or not restarts.died(name, how):
                self.raise_failure()
        by_name = {spec.name: spec for spec in self.specs}
        for name in restarts.due():
            self.processes[name] = self._start(by_name[name], rejoin=True)

    def wait(
        self,
        until: str = "if_source",
        *,
        poll: Callable[[], object] = lambda: None,
        timeout: float | None = None,
    ) -> None:
        """Wait for the process ``until`` to end well.

        Raises
        ------
        InputError
            A process failed (its last line is in the error), or time ran out.
        """
        started = time.monotonic()
        while self.processes[until].poll() is None:
            self.tend(until)
            poll()
            if timeout is not None and time.monotonic() - started > timeout:
                raise InputError(f"node {until}", f"did not end within {timeout:g} s")
            time.sleep(0.02)
        self.raise_failure()

    def raise_failure(self) -> None:
        """Raise the error of a process that ended badly.

        Raises
        ------
        InputError
            In a node's own words: what was wrong with its input (exit status 2).
        NodeFailureError
            A node failed or was killed.
        """
        if self.failed() is None:
            return
        self._await_culprits()
        ended = {name: status for name, status in self.statuses().items() if status}
        name, status = min(ended.items(), key=lambda item: (item[1] != BAD_INPUT, item[1] > 0))
        line = self.last_line(name)
        if status == BAD_INPUT:
            what, _, reason = line.removeprefix(f"{name}: ").partition(": ")
            raise InputError(what, reason)
        if name in self.stuck:
            raise NodeFailureError(name, self.stuck[name], "killed", self.log_of(name))
        raise NodeFailureError(name, ending(status), line, self.log_of(name))

    def _await_culprits(self) -> None:
        """Wait for the end of who others say has given up; bad input and signals are causes."""
        time.sleep(0.3)
        deadline = time.monotonic() + CULPRIT_SECONDS
        while time.monotonic() < deadline:
            ended = [name for name, status in self.statuses().items() if status]
            named = {GAVE_UP.search(self.last_line(name)) for name in ended}
            culprits = [match[1] for match in named if match and match[1] in self.processes]
            if all(self.processes[name].poll() is not None for name in culprits):
                return
            time.sleep(0.05)

    def stop(self) -> None:
        """End everything that still runs, the recorder last; kill what does not end."""
        self.end([name for name in self.processes if name != "recorder"])
        self.end(["recorder"])

    def end(self, names: Sequence[str]) -> None:
        """Interrupt these nodes and wait for them; kill what does not end."""
        processes = {name: self.processes[name] for name in names if name in self.processes}
        for process in processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + STOP_SECONDS
        for name, process in processes.items():
            try:
                process.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                self.kill_stuck(name, f"did not end within {STOP_SECONDS:g} s")
                process.wait()

    def kill_stuck(self, name: str, why: str) -> None:
        """Kill a node that stands still; its log tells where."""
        self.stuck[name] = why
        self.processes[name].send_signal(signal.SIGQUIT)
        time.sleep(0.3)
        self.processes[name].kill()

    def statuses(self) -> dict[str, int | None]:
        """Return the exit status of every process; None: runs, or will be started again."""
        waits = self.restarts.waits if self.restarts is not None else lambda _name: False
        return {
            name: None if waits(name) else process.poll()
            for name, process in self.processes.items()
        }


class NodeFailureError(InputError):
    """A node of the graph failed."""

    def __init__(self, name: str, how: str, line: str, log: Path) -> None:
        self.name = name
        super().__init__(f"node {name}", f"{how}: {line}", f"log: {log}")


class StandstillError(InputError):
    """The graph stands still, though all its nodes live: what it left says who waits for whom."""


@contextmanager
def running(supervisor: Supervisor) -> Iterator[Supervisor]:
    """Start the graph; end it whatever happens; what fails at the end is an error too."""
    try:
        supervisor.start()
        yield supervisor
    finally:
        supervisor.stop()
    supervisor.raise_failure()


@contextmanager
def own_domain() -> Iterator[Mapping[str, str]]:
    """Give the graph a DDS domain nobody else uses, unless ROS_DOMAIN_ID is set."""
    if os.environ.get("ROS_DOMAIN_ID"):
        yield {}
        return
    from domain_coordinator import domain_id

    with domain_id() as number:
        yield {"ROS_DOMAIN_ID": str(number)}


def describe(specs: list[NodeSpec]) -> list[dict[str, Any]]:
    """Return the graph as plain data, for the record."""
    return [
        {
            "name": spec.name,
            "package": spec.package,
            "executable": spec.executable,
            "publishes": list(spec.publishes),
            "subscribes": list(spec.subscribes),
            "parameters": dict(spec.parameters),
        }
        for spec in specs
    ]
