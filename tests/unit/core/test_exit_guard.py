"""A process that cannot end by itself ends all the same, with its own status."""

import subprocess
import sys
import time

SCRIPT = """
import ctypes, sys
from deepseis_core.ros.exit_guard import leave_within
leave_within({seconds}, {status})
{rest}
"""
HOLDS_THE_INTERPRETER = "ctypes.PyDLL(None).sleep(30)"  # no thread and no handler of Python runs


def run(seconds, status, rest):
    started = time.monotonic()
    script = SCRIPT.format(seconds=seconds, status=status, rest=rest)
    result = subprocess.run([sys.executable, "-c", script], timeout=25)
    return result.returncode, time.monotonic() - started


def test_a_process_that_holds_the_interpreter_ends_with_its_status():
    for status in (0, 2):
        code, took = run(0.5, status, HOLDS_THE_INTERPRETER)
        assert code == status
        assert took > 0.5


def test_a_process_that_ends_in_time_is_left_alone():
    code, took = run(20.0, 0, "sys.exit(3)")
    assert code == 3
    assert took < 15.0
