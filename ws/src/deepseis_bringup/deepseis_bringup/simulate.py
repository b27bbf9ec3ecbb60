"""Makes an input bag from a scenario: samples, truth, navigation data, summary."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from deepseis_bringup.mcap_recording import BagWriter
from deepseis_bringup.ros_definitions import TopicQos
from deepseis_bringup.run_records import input_hash, versions
from deepseis_bringup.runs import progress_bar
from deepseis_core.errors import InputError
from deepseis_core.ros import codecs, qos
from deepseis_core.sample_clock import SampleClock
from deepseis_frontend.if_file import IfFile
from deepseis_sim.recording import SimulatedRecording
from deepseis_sim.scenario import StillConfig, simulate_still

TOPIC, TYPE = "/if/samples", "deepseis_msgs/msg/IfBlock"


@contextmanager
def nothing_half_written(folder: Path) -> Iterator[None]:
    """Make a folder, and empty it again if what fills it fails."""
    existed = folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(folder, f"cannot be made: {error.strerror}") from None
    try:
        yield
    except BaseException:
        for path in folder.iterdir():
            shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink()
        if not existed:
            folder.rmdir()
        raise


def write_input_bag(
    recording: Path, folder: Path, progress: Callable[[float], object] = lambda _done: None
) -> None:
    """Write a raw recording with a descriptor as a bag that replays as input.

    Parameters
    ----------
    recording : Path
        Raw IF.
    folder : Path
        The bag's folder, made new.
    progress : callable, optional
        Called with the seconds written.
    """
    source = IfFile(recording)
    clock = SampleClock(source.start_utc_ns or 0, source.sample_rate_hz)
    with BagWriter(folder) as bag:
        bag.add_topic(TOPIC, TYPE, TopicQos(depth=qos.STREAM.depth))
        for block in source.blocks():
            stamp = clock.utc_ns(block.sample_index)
            bag.write(TOPIC, TYPE, codecs.IF_BLOCK.encode(block, stamp), stamp, stamp)
            progress((block.sample_index + block.sample_count) / block.sample_rate_hz)


def still(
    config: StillConfig,
    folder: Path,
    *,
    keep_raw: bool = False,
) -> dict[str, Any]:
    """Simulate a still antenna into ``folder``.

    Parameters
    ----------
    config : StillConfig
        The scenario.
    folder : Path
        New or empty. Gets ``bag/``, ``truth.npz``, ``nav.rnx`` and ``summary.json``.
    keep_raw : bool
        Leave the raw IF file and its descriptor too.

    Returns
    -------
    dict
        The summary.

    Raises
    ------
    InputError
        A setting makes no sense or the folder cannot be written.
    """
    with nothing_half_written(folder):
        with progress_bar("making the signal", config.duration) as show:
            made = simulate_still(config, folder, progress=show)
        with progress_bar("writing the bag", config.duration) as show:
            write_input_bag(made.if_path, folder / "bag", show)
        summary = _summary(config, made)
        if not keep_raw:
            made.if_path.unlink()
            made.descriptor_path.unlink()
        (folder / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    return summary


def _summary(config: StillConfig, made: SimulatedRecording) -> dict[str, Any]:
    return {
        "scenario": "still",
        "seed": config.seed,
        "duration_s": made.sample_count / config.sample_rate_hz,
        "sample_count": made.sample_count,
        "sample_rate_hz": config.sample_rate_hz,
        "intermediate_frequency_hz": config.intermediate_frequency_hz,
        "if_format": config.if_format,
        "satellites": list(made.satellites),
        "if_sha256": input_hash(made.if_path),
        **{f"version_{name}": value for name, value in versions().items()},
    }
