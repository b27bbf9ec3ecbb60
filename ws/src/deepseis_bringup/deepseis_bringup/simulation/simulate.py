"""Makes an input bag from a scenario, with the truth, the figures and the pictures beside it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

from deepseis_bringup.bags.input_bag import ORDER, InputBag
from deepseis_bringup.bags.run_records import input_hash, versions
from deepseis_bringup.run_folder import half_written_is_removed, never
from deepseis_bringup.runs import progress_bar
from deepseis_bringup.simulation.page import page
from deepseis_bringup.simulation.pictures import Pictures
from deepseis_core.rinex_nav import write_rinex_nav
from deepseis_core.types import Truth
from deepseis_frontend.if_descriptor import IfDescriptor, write_descriptor
from deepseis_pvt.rinex_obs import RinexObsWriter, RinexStation
from deepseis_sim.bench import Bench
from deepseis_sim.bench_streams import Item
from deepseis_sim.scenario import Scenario, summary_of
from deepseis_sim.truth_file import TruthFile


def simulate(
    scenario: Scenario,
    folder: Path,
    *,
    keep_raw: bool = False,
    progress: bool = True,
) -> dict[str, Any]:
    """Simulate a scenario into ``folder``.

    Parameters
    ----------
    scenario : Scenario
    folder : Path
        New or empty. Gets ``bag/``, ``truth.npz``, ``nav.rnx``, RINEX of the base and of
        observations that stand for the signal, ``summary.json`` and ``report.html``.
    keep_raw : bool, optional
        Leave the samples as ``if.bin`` with a descriptor too.
    progress : bool, optional
        Show a bar on stderr.

    Returns
    -------
    dict
        The summary.

    Raises
    ------
    InputError
        A setting makes no sense, or a file cannot be read.
    OSError
        A file cannot be written.
    """
    with half_written_is_removed(folder, keep=never):
        bench = Bench(scenario)
        with ExitStack() as stack:
            show: Callable[[float], object] = lambda _done: None  # noqa: E731
            if progress:
                show = stack.enter_context(progress_bar(scenario.name, scenario.duration))
            outlet = stack.enter_context(_Outlet(bench, folder, keep_raw))
            for begin, end in bench.spans():
                outlet.write(bench.items(begin, end))
                show(end / bench.sample_rate_hz)
        summary = {
            **summary_of(scenario),
            **bench.figures(),
            **outlet.pictures.figures(),
            **{f"messages.{name}": n for name, n in outlet.bag.counts.items() if n},
            **({"if_sha256": outlet.digest.hexdigest()} if scenario.signal else {}),
            "bag_sha256": input_hash(folder / "bag"),
            **{f"version_{name}": value for name, value in versions().items()},
        }
        (folder / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
        text = page(outlet.pictures, summary, folder, scenario.title or scenario.name)
        (folder / "report.html").write_text(text, encoding="utf-8")
    return summary


class _Outlet:
    """The files of a simulated run; a context manager."""

    def __init__(self, bench: Bench, folder: Path, keep_raw: bool) -> None:
        self.bench, self.folder = bench, folder
        self.digest, self.pictures = hashlib.sha256(), Pictures(bench)
        self.keep_raw = keep_raw and bench.scenario.signal
        self._stack = ExitStack()
        self._rinex: dict[str, RinexObsWriter] = {}

    def __enter__(self) -> _Outlet:
        bench, enter = self.bench, self._stack.enter_context
        utc_ns = bench.start.to_utc_ns()
        self.bag = enter(InputBag(self.folder / "bag", utc_ns, bench.records()))
        self.truth = enter(TruthFile(self.folder / "truth.npz"))
        self.raw: BinaryIO | None = None
        if self.keep_raw:
            self.raw = enter((self.folder / "if.bin").open("wb"))
        for item in bench.opening():
            self._value(item)
        return self

    def write(self, items: list[Item]) -> None:
        """Write the values of a span in order of validity."""
        for item in sorted(items, key=lambda item: (item.offset_ns, ORDER[item.topic])):
            self._value(item)

    def _value(self, item: Item) -> None:
        self.bag.write(item.topic, item.value, item.offset_ns, item.stamp_ns)
        self.pictures.add(item)
        if item.topic == "if/samples":
            data = item.value.data
            self.digest.update(data)
            if self.raw:
                self.raw.write(data)
        elif item.topic == "truth":
            self.truth.append(**_truth_arrays(item.value, self.bench))
        elif item.topic in ("base/observations", "gnss/observations"):
            self._rinex_writer(item.topic).write(item.value)

    def _rinex_writer(self, topic: str) -> RinexObsWriter:
        if topic not in self._rinex:
            name, position = "DSEI00XXX", self.bench.antenna_ecef
            if topic.startswith("base") and self.bench.base:
                name, position = "BASE00XXX", self.bench.base.position_ecef
            x, y, z = (float(value) for value in position)
            station = RinexStation(name, marker=name[:4], position_ecef=(x, y, z))
            writer = RinexObsWriter(self.folder, station, created=_utc(self.bench))
            self._rinex[topic] = self._stack.enter_context(writer)
        return self._rinex[topic]

    def __exit__(self, *reason: Any) -> None:
        if reason[0] is None:
            self.truth.put(**self.bench.truth_constants())
            self._write_nav()
            if self.raw:
                self._write_descriptor()
        self._stack.__exit__(*reason)

    def _write_descriptor(self) -> None:
        front_end = self.bench.front_end
        descriptor = IfDescriptor(
            front_end.format,
            front_end.sample_rate_hz,
            front_end.intermediate_frequency_hz,
            self.bench.start.to_utc_ns(),
        )
        write_descriptor(self.folder / "if.bin", descriptor)

    def _write_nav(self) -> None:
        start = self.bench.start
        write_rinex_nav(
            self.folder / "nav.rnx",
            [item.ephemeris for item in self.bench.model.satellites],
            leap_seconds=start.leap_seconds(),
            date=f"{_utc(self.bench):%Y%m%d %H%M%S} UTC",
        )


def _utc(bench: Bench) -> datetime:
    """Date files by the signal's start: same seed, same bytes."""
    return datetime.fromtimestamp(bench.start.to_utc_ns() // 10**9, UTC)


def _truth_arrays(truth: Truth, bench: Bench) -> dict[str, Any]:
    """Return the rows of ``truth.npz`` that one batch adds."""
    t = truth.satellite_sample_index / bench.sample_rate_hz
    rows: dict[str, Any] = {
        "motion_t_s": truth.sample_index / bench.sample_rate_hz,
        "antenna_ecef_m": truth.position_ecef,
        "velocity_ecef": truth.velocity_ecef,
        "acceleration_ecef": truth.acceleration_ecef,
        "orientation_xyzw": truth.orientation_xyzw,
        "t_s": t,
        "range": truth.range,
        "pseudorange": truth.pseudorange,
        "carrier_phase_cycles": truth.carrier_phase_cycles,
        "carrier_doppler_hz": truth.carrier_doppler_hz,
        "satellite_cn0_dbhz": truth.cn0_dbhz,
        "clock_bias": truth.clock_bias,
    }
    if bench.gravity:
        rows["gravity_disturbance"] = bench.gravity_disturbance(t)
    return rows
