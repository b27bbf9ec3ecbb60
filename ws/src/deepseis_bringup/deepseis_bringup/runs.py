"""Runs of the graph on a recording: demo, replay, process. Each leaves a run folder."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

from deepseis_bringup.bags.recorded_misses import recorded_misses
from deepseis_bringup.bags.run_records import input_hash, recorded_run, versions, with_records
from deepseis_bringup.base import base_parameters, base_position, has_base, knows_its_base
from deepseis_bringup.graph import ALL_SATELLITES, GraphConfig, build_graph
from deepseis_bringup.inertial import (
    assistance,
    has_imu,
    inertial_parameters,
    installed_parameters,
)
from deepseis_bringup.live.live_page import LivePage, live_page
from deepseis_bringup.live.web_options import WebOptions
from deepseis_bringup.restarts import Restarts
from deepseis_bringup.supervisor import Supervisor, own_domain, running
from deepseis_bringup.watch import GraphWatch
from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.sample_clock import utc_ns_from_iso
from deepseis_frontend.if_open import open_source
from deepseis_frontend.if_soapy import is_live
from deepseis_frontend.if_stream import IfSource
from deepseis_frontend.imu_file import Installation
from deepseis_frontend.nodes.station_bag import read_station
from deepseis_frontend.ntrip import is_address

console = Console(stderr=True)


@dataclass(frozen=True)
class Selection:
    """Which recording to run on; as the parameters of ``if_source``."""

    file: str
    format: str = ""
    sample_rate_hz: float = 0.0
    intermediate_frequency_hz: float = 0.0
    start_utc: str = ""
    start_s: float = 0.0
    length_s: float = 0.0

    def parameters(self) -> dict[str, Any]:
        """Return the parameters that were given."""
        file = self.file if is_live(self.file) else str(Path(self.file).resolve())
        values = {**vars(self), "file": file}
        return {key: value for key, value in values.items() if value not in ("", 0.0)}


@dataclass(frozen=True)
class RunOptions:
    """How to run."""

    mode: str = "lockstep"
    satellites: tuple[str, ...] = ALL_SATELLITES
    one_process: bool = True
    record: bool = True
    record_if: bool = True
    aiding: str = ""
    base: bool = False
    base_from: str = ""
    imu_file: str = ""
    installation: Installation | None = None
    repeat_misses: bool = True
    misses: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    timeout: float | None = None
    web: WebOptions | None = None


SHORT_S = 3.0
"""Recordings below this length [s] are searched with less signal, to leave some for tracking."""

SHORT_SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "acquisition": {"slot_ms": 100, "noncoherent_count": 24},
    "tracker": {"slot_ms": 100, "pull_in_ms": 100},
}


@contextmanager
def progress_bar(text: str, total: float, unit: str = "s") -> Iterator[Any]:
    """Show a bar on stderr; yields a function that takes what is done so far.

    ``total`` 0 is unknown: the bar only moves.
    """
    of_total = f"{{task.completed:.0f}} of {{task.total:.0f}} {unit}"
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn(of_total if total else f"{{task.completed:.0f}} {unit}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=not console.is_terminal) as progress:
        task = progress.add_task(text, total=total or None)
        yield lambda done: progress.update(task, completed=done)


def run_recording(
    selection: Selection, folder: Path, options: RunOptions, *, progress: bool = True
) -> dict[str, Any]:
    """Run the graph on a recording into ``folder``.

    Parameters
    ----------
    selection : Selection
        The recording.
    folder : Path
        Run folder; exists.
    options : RunOptions
        How to run.
    progress : bool
        Show a bar.

    Returns
    -------
    dict
        Figures of the run for the summary: duration, wall time, real-time factor, hashes.

    Raises
    ------
    InputError
        The recording cannot be used, or a node failed.
    """
    source = open_source(selection)
    started = time.monotonic()
    sha256 = input_hash(Path(selection.file))
    config = with_records(graph_config(selection, source, folder, options), sha256)
    restarts = Restarts() if options.mode == "realtime" else None
    with own_domain() as environment:
        supervisor = Supervisor(
            build_graph(replace(config, watched=True)),
            folder,
            environment=environment,
            restarts=restarts,
        )
        members = [spec.name for spec in supervisor.specs if spec.name != "if_source"]
        with (
            live_page(options.web, folder, _say, environment) as pages,
            running(supervisor),
            GraphWatch(environment, members=members, restarts=restarts) as watch,
        ):
            elapsed = _follow(supervisor, watch, pages, source, options, progress)
    duration = _seconds(source, watch.valid_through)
    if duration <= 0:
        raise InputError(selection.file, "no sample came through the graph")
    remarks = supervisor.warnings("if_source")
    for text in remarks:
        _say(text)
    return {
        **({"input_remarks": "; ".join(remarks)} if remarks else {}),
        "input": str(Path(selection.file).name),
        "input_sha256": sha256,
        "duration_s": round(duration, 6),
        "wall_time_s": round(time.monotonic() - started, 3),
        "graph_time_s": round(elapsed, 3),
        "real_time_factor": round(duration / elapsed, 3) if elapsed else 0.0,
        "mode": options.mode,
        **({"restarts": restarts.count} if restarts is not None else {}),
        **{f"version_{name}": value for name, value in versions().items()},
    }


def _say(text: str) -> None:
    console.print(f"deepseis: {text}", highlight=False, soft_wrap=True, markup=False)


def _follow(
    supervisor: Supervisor,
    watch: GraphWatch,
    pages: Sequence[LivePage],
    source: IfSource,
    options: RunOptions,
    progress: bool,
) -> float:
    """Wait for the end, showing how far the source is; returns the graph's wall time [s]."""
    total = (source.total_samples or 0) / source.sample_rate_hz
    with progress_bar("running the graph", total) if progress else nullcontext() as show:

        def poll() -> None:
            done = watch.poll()
            watch.require_progress()
            for page in pages:
                page.tend()
            if show is not None:
                show(_seconds(source, done))

        supervisor.wait(poll=poll, timeout=options.timeout)
        elapsed = watch.elapsed()
        poll()
    return elapsed


def _seconds(source: IfSource, valid_through: int) -> float:
    """Seconds of a recording played through a sample."""
    return max(0, valid_through + 1 - source.first_sample) / source.sample_rate_hz


def graph_config(
    selection: Selection, source: IfSource, folder: Path, options: RunOptions
) -> GraphConfig:
    """Return the graph for a recording and a run folder."""
    given = selection.start_utc
    start_ns = utc_ns_from_iso(given) if given else source.start_utc_ns
    parameters = {kind: dict(values) for kind, values in options.parameters.items()}
    if start_ns:
        week = GpsTime.from_utc_ns(start_ns).week
        for kind in ("tracker", "acquisition"):
            parameters.setdefault(kind, {}).setdefault("reference_week", week)
    imu, found = options.imu_file, {}
    if imu:
        place = parameters.get("pvt", {}).get("position_ecef", ())
        found = installed_parameters(Path(imu), source, options.installation, place)
    elif options.aiding == "fusion":
        found = inertial_parameters(Path(selection.file), source)
    if options.base_from:
        if len(parameters.get("pvt", {}).get("position_ecef", ())) != 3:
            hint = "--position, or parameters.pvt.position_ecef"
            raise InputError("a base", "serves a surveyed antenna, whose place is not known", hint)
        found["base_source"] = base_parameters(options.base_from, source, start_ns or 0)
    if found and selection.start_s and "fusion" in found:
        found["fusion"]["start_s"] = selection.start_s
    for kind, known in found.items():
        parameters[kind] = {**known, **parameters.get(kind, {})}
    if source.total_samples and source.total_samples < SHORT_S * source.sample_rate_hz:
        for kind, values in SHORT_SETTINGS.items():
            parameters[kind] = {**values, **parameters.get(kind, {})}
    return GraphConfig(
        source=selection.parameters(),
        sample_rate_hz=source.sample_rate_hz,
        satellites=options.satellites,
        mode=options.mode,
        one_process=options.one_process,
        aiding="fusion" if imu else options.aiding,
        base=options.base or bool(options.base_from),
        base_from=_resolved(options.base_from),
        imu_file=str(Path(imu).resolve()) if imu else "",
        record_dir=str((folder / "bag").resolve()) if options.record else "",
        record_if=options.record_if,
        output_dir=str(folder.resolve()),
        misses=options.misses,
        parameters=parameters,
    )


def _resolved(base: str) -> str:
    return base if not base or is_address(base) else str(Path(base).resolve())


def demo(
    folder: Path, *, duration: float = 40.0, if_format: str = "iq2", seed: int = 1
) -> dict[str, Any]:
    """Simulate a still antenna, run the graph on the signal over DDS, report."""
    from deepseis_bringup.report.run_report import write_report
    from deepseis_sim.still_recording import StillConfig, simulate_still

    config = replace(StillConfig(), duration=duration, if_format=if_format, seed=seed)
    with progress_bar("making the signal", duration) as show:
        recording = simulate_still(config, folder / "input", progress=show)
    selection = Selection(str(recording.if_path))
    figures = run_recording(selection, folder, RunOptions())
    figures["seed"] = seed
    recording.if_path.unlink()  # the samples are in the bag
    with console.status("writing the report"):
        return write_report(
            folder, truth=recording.truth_path, title="DeepSeis demo", extra=figures
        )


def replay(bag: Path, folder: Path, options: RunOptions, *, title: str = "") -> dict[str, Any]:
    """Run the graph again on a recorded bag's samples, with the parameters of the recorded run.

    Where the bag lies in a folder with the truth of its simulation, the report compares with it;
    with an IMU in the bag and orbits (``nav.rnx``) beside it the station starts assisted. What a
    realtime run did not wait for, its replay in lockstep does not wait for either.
    """
    from deepseis_bringup.report.run_report import write_report

    recorded = recorded_run(bag)
    if options.aiding == "auto":
        there = has_imu(bag)
        described = there and read_station(bag) is not None
        if there and not described:
            console.print("deepseis: the IMU is left aside: the bag does not describe its station")
        options = replace(options, aiding="fusion" if described else "")
    satellites = recorded.satellites if options.satellites == ALL_SATELLITES else ()
    known = assistance(bag) if options.aiding == "fusion" else {}
    with_base = has_base(bag)
    if with_base and "pvt" in known and (place := base_position(bag)):
        known["pvt"]["base_position_ecef"] = place
    layers = (known, recorded.parameters, options.parameters)
    kinds = {kind for layer in layers for kind in layer}
    options = replace(
        options,
        satellites=satellites or options.satellites,
        parameters={
            kind: {name: value for layer in layers for name, value in layer.get(kind, {}).items()}
            for kind in sorted(kinds)
        },
    )
    placed = options.parameters.get("pvt", {})
    told = "base_position_ecef" in placed or knows_its_base(bag)
    options = replace(options, base=with_base and told and "position_ecef" in placed)
    if options.mode == "lockstep" and options.repeat_misses:
        options = with_misses(options, bag)
    figures = run_recording(Selection(str(bag)), folder, options)
    title = title or f"Replay of {(bag.parent if bag.name == 'bag' else bag).resolve().name}"
    with console.status("writing the report"):
        return write_report(folder, truth=_truth_beside(bag), title=title, extra=figures)


def with_misses(options: RunOptions, bag: Path) -> RunOptions:
    """Return the options of a replay that repeats the misses of a recorded realtime run."""
    found = recorded_misses(bag)
    if found.restarts:
        text = f"deepseis: {found.restarts} restarts of nodes in this run are not repeated"
        console.print(text, highlight=False)
    if not found.by_member:
        return options
    return replace(options, misses=found.by_member, one_process=found.one_process)


def _truth_beside(bag: Path) -> Path | None:
    """Find the truth of a simulated input bag, or of a run on one."""
    home = bag.resolve().parent
    places = (home / "truth.npz", home / "input" / "truth.npz")
    return next((path for path in places if path.is_file()), None)
