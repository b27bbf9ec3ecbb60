"""Timers go on when the wall clock is set: proved with a clock that is, and kept so by a look."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[3] / "ws" / "src"
CLOCK = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <time.h>
int clock_gettime(clockid_t id, struct timespec *t) {
    static int (*real)(clockid_t, struct timespec *);
    struct stat s;
    if (!real) real = dlsym(RTLD_NEXT, "clock_gettime");
    int result = real(id, t);
    if (id == CLOCK_REALTIME && stat(getenv("STEP_FILE"), &s) == 0) t->tv_sec -= 3600;
    return result;
}
"""
NODE = """
import os, time
import rclpy
from rclpy.experimental import EventsExecutor
from deepseis_core.ros.steady import every
rclpy.init()
node, executor = rclpy.create_node("a"), EventsExecutor()
executor.add_node(node)
calls = {"wall": 0, "steady": 0}
def count(name):
    calls[name] += 1
node.create_timer(0.05, lambda: count("wall"))
every(node, 0.05, lambda: count("steady"))
def spin(enough):
    calls.update(wall=0, steady=0)
    end = time.monotonic() + 30
    while calls["steady"] < enough and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
spin(5)
assert calls["wall"] > 0, calls
before = time.time()
open(os.environ["STEP_FILE"], "w").close()
assert time.time() < before - 3000, "the clock was not set back"
spin(20)
print(calls["steady"] >= 20, calls["wall"] <= 2)
"""


@pytest.mark.timeout(120)
def test_a_wall_clock_set_back_by_an_hour_stops_no_steady_timer(tmp_path):
    pytest.importorskip("rclpy")
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("needs a C compiler for a clock of its own")
    (tmp_path / "step.c").write_text(CLOCK)
    library = tmp_path / "step.so"
    command = [compiler, "-shared", "-fPIC", "-o", library, tmp_path / "step.c", "-ldl"]
    subprocess.run(command, check=True)
    environment = dict(
        os.environ,
        LD_PRELOAD=str(library),
        STEP_FILE=str(tmp_path / "set"),
        PYTHONPATH=os.pathsep.join(p for p in sys.path if p),
    )
    done = subprocess.run(
        [sys.executable, "-c", NODE], env=environment, capture_output=True, text=True, timeout=100
    )
    # The second: rclpy's own timer does stop, or there would be nothing to guard against.
    assert done.stdout.split() == ["True", "True"], done.stderr


def test_no_node_has_timers_of_the_wall_clock_and_no_recording_reads_it():
    for path in SOURCES.glob("deepseis_*/deepseis_*/**/*.py"):
        text = path.read_text()
        assert path.name == "steady.py" or "create_timer(" not in text, f"{path}: use steady.every"
        if re.search("archive|mcap|record", path.name):
            assert not re.search(r"\btime\.time(_ns)?\(|datetime\.now", text), path
