"""How every node's process starts and ends."""

from __future__ import annotations

import faulthandler
import os
import signal
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from types import FrameType
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions

from deepseis_core.errors import DiskError, InputError
from deepseis_core.ros.exit_guard import leave_within
from deepseis_core.ros.reach import choose_reach

LEAVE_SECONDS = 6.0
"""Time for DDS and the interpreter to take themselves apart once all files are closed [s]."""


@dataclass(frozen=True)
class Stop:
    """How a node ends its process: exit status and a last line."""

    status: int = 0
    line: str = ""


class Process:
    """What the nodes of one process share: the executor, and how to end."""

    def __init__(self) -> None:
        self.executor = EventsExecutor()
        self.stopped: Stop | None = None
        self.nodes: list[Any] = []

    def add(self, node: Any) -> None:
        """Spin this node too."""
        self.nodes.append(node)
        self.executor.add_node(node)

    def stop(self, status: int = 0, line: str = "") -> None:
        """End the process after the present callback."""
        if self.stopped is None:
            self.stopped = Stop(status, line)
            self.executor.wake()

    def spin(self) -> None:
        """Run callbacks until someone stops the process."""
        while self.stopped is None:
            self.executor.spin_once(timeout_sec=0.5)


def run(build: Callable[[Process], None], name: str, args: list[str] | None = None) -> None:
    """Run a process of nodes: ``build(process)`` makes them.

    Exit status 0 after an orderly end or a signal, 2 for bad input (one line on stderr), 1 for
    a failure.
    """
    choose_reach(os.environ)
    faulthandler.register(signal.SIGQUIT)  # where a process stands that does not end
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rcl has many names for arguments that it cannot read
        print(f"{name}: {' '.join(str(error).split())}", file=sys.stderr, flush=True)
        sys.exit(2)
    process = Process()

    def on_signal(_number: int, _frame: FrameType | None) -> None:
        process.stop()

    signal.signal(signal.SIGINT, on_signal)
    signal.signal(signal.SIGTERM, on_signal)
    status = 0
    try:
        build(process)
        process.spin()
        if process.stopped is not None:
            status = process.stopped.status
            if process.stopped.line:
                print(f"{name}: {process.stopped.line}", file=sys.stderr, flush=True)
    except InputError as error:
        print(f"{name}: {error}", file=sys.stderr, flush=True)
        status = _status(error)
    except ExternalShutdownException:
        pass
    except Exception:
        traceback.print_exc()
        status = 1
    for node in process.nodes:
        try:
            close = getattr(node, "close", None)
            if close is not None:
                close()
        except InputError as error:
            print(f"{name}: {error}", file=sys.stderr, flush=True)
            status = status or _status(error)
        except Exception:
            traceback.print_exc()
            status = status or 1
    faulthandler.dump_traceback_later(0.9 * LEAVE_SECONDS)
    leave_within(LEAVE_SECONDS, status)
    for node in process.nodes:
        node.destroy_node()
    rclpy.try_shutdown()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # everything is done: no signal changes the status
    sys.exit(status)


def _status(error: InputError) -> int:
    """Return 2 for bad input, 1 for a disk that did not take what there was."""
    return 1 if isinstance(error, DiskError) else 2
