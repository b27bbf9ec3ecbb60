"""A station's configuration file: what it may say, and the graph that it asks for."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from deepseis_bringup.alert import AlertConfig, checked
from deepseis_bringup.bags.archive import ArchiveConfig, free_bytes
from deepseis_bringup.bags.archive_report import estimate
from deepseis_bringup.bags.bag_place import bag_of
from deepseis_bringup.bags.run_records import with_records
from deepseis_bringup.graph import ALL_SATELLITES, KINDS, GraphConfig
from deepseis_bringup.live.web_options import WebOptions
from deepseis_bringup.runs import RunOptions, Selection, graph_config
from deepseis_core.errors import InputError
from deepseis_core.yaml_config import Entry, fill, read_yaml
from deepseis_frontend.if_open import open_source
from deepseis_frontend.if_soapy import is_live
from deepseis_frontend.imu_file import Installation
from deepseis_frontend.ntrip import is_address

MODES = ("realtime", "lockstep")
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
ARCHIVE_KEYS = tuple(item.name for item in fields(ArchiveConfig))
WEB_KEYS = tuple(item.name for item in fields(WebOptions))
ALERT_KEYS = tuple(item.name for item in fields(AlertConfig))
IMU_KEYS = ("file", *(item.name for item in fields(Installation)))
BASE_KEYS = ("from", "position_ecef")
SOURCE_KEYS = (*(item.name for item in fields(Selection)), "pace", "window_blocks")


REALTIME_LATENCY_SLOTS = 4
"""Time for a cold search of 32 satellites while the clock runs: 2 s at 0.5 s a slot."""


@dataclass(frozen=True)
class StationConfig:
    """What a station's file says; ``config/station.yaml`` explains every value."""

    station: str = ""
    source: Mapping[str, Any] = field(default_factory=dict)
    satellites: tuple[str, ...] = ALL_SATELLITES
    mode: str = "realtime"
    one_process: bool = True
    record: bool = True
    record_if: bool = True
    archive: ArchiveConfig = field(default_factory=ArchiveConfig)
    imu: Mapping[str, Any] = field(default_factory=dict)
    live_page: WebOptions | None = None
    alert: AlertConfig = field(default_factory=AlertConfig)
    base: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def selection(self) -> Selection:
        """The recording to be played."""
        names = {item.name for item in fields(Selection)}
        return Selection(**{"file": "", **{k: v for k, v in self.source.items() if k in names}})

    @property
    def options(self) -> RunOptions:
        """How to run it."""
        pacing = {k: v for k, v in self.source.items() if k in ("pace", "window_blocks")}
        parameters = {kind: dict(values) for kind, values in self.parameters.items()}
        parameters["if_source"] = {**pacing, **parameters.get("if_source", {})}
        if self.archive != ArchiveConfig():
            parameters["recorder"] = {**vars(self.archive), **parameters.get("recorder", {})}
        if self.base.get("position_ecef"):
            known = {"base_position_ecef": self.base["position_ecef"]}
            parameters["pvt"] = {**known, **parameters.get("pvt", {})}
        if self.mode == "realtime":
            search = parameters.get("acquisition", {})
            parameters["acquisition"] = {"latency_slots": REALTIME_LATENCY_SLOTS, **search}
        return RunOptions(
            mode=self.mode,
            satellites=self.satellites,
            one_process=self.one_process,
            record=self.record,
            record_if=self.record_if,
            base_from=self.base.get("from", ""),
            imu_file=self.imu.get("file", ""),
            installation=self.imu.get("installation"),
            parameters=parameters,
        )

    def estimate(self, folder: Path) -> list[str]:
        """Say what recording into ``folder`` will take, and whether it fits."""
        if not self.record or self.mode == "lockstep":
            return []
        source = open_source(self.selection)
        rate = source.format.bytes_for(round(source.sample_rate_hz)) * self.record_if
        pace = float(self.source.get("pace", 1.0))
        return estimate(self.archive, rate * pace, free_bytes(folder))

    def graph(self, folder: Path) -> GraphConfig:
        """Return the graph that runs into ``folder``; its bag records the settings for replay.

        The input is not hashed: a station begins at once, however long the recording.

        Raises
        ------
        InputError
            The recording cannot be used.
        """
        source = open_source(self.selection)
        return with_records(graph_config(self.selection, source, folder, self.options), "")


def read_station_config(path: str | Path) -> StationConfig:
    """Read a station's configuration file.

    Parameters
    ----------
    path : path
        YAML; files that it names are relative to its folder.

    Raises
    ------
    InputError
        The file cannot be read, a key is unknown or a value makes no sense.
    """
    return station_config(read_yaml(path).plain(), Path(path))


def station_config(values: Any, path: Path) -> StationConfig:
    """Check what a configuration file says (see `read_station_config`)."""
    check = _Checker(path)
    known = tuple(item.name for item in fields(StationConfig))
    values = check.mapping(values, "the file", known)
    source = check.mapping(values.get("source"), "source", SOURCE_KEYS)
    sections = check.mapping(values.get("parameters"), "parameters", KINDS)
    parameters = {
        kind: check.mapping(given, f"parameters.{kind}") for kind, given in sections.items()
    }
    config = StationConfig(
        station=check.name(values.get("station")),
        source=check.source(source),
        satellites=check.satellites(values.get("satellites", "all")),
        archive=check.archive(check.mapping(values.get("archive"), "archive", ARCHIVE_KEYS)),
        imu=check.imu(check.mapping(values.get("imu"), "imu", IMU_KEYS)),
        live_page=check.live_page(check.mapping(values.get("live_page"), "live_page", WEB_KEYS)),
        alert=check.alert(check.mapping(values.get("alert"), "alert", ALERT_KEYS)),
        base=check.base(check.mapping(values.get("base"), "base", BASE_KEYS)),
        mode=str(values.get("mode", "realtime")),
        parameters=check.files(parameters),
        **{key: check.truth(values, key) for key in ("one_process", "record", "record_if")},
    )
    check.that(config.mode in MODES, f"mode is {config.mode!r}", "realtime or lockstep")
    return config


class _Checker:
    """Complains in the words of the file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def that(self, condition: bool, reason: str, hint: str = "") -> None:
        if not condition:
            raise InputError(self.path, reason, hint)

    def mapping(self, value: Any, name: str, known: tuple[str, ...] = ()) -> dict[str, Any]:
        value = {} if value is None else value
        is_mapping = isinstance(value, dict) and all(isinstance(key, str) for key in value)
        self.that(is_mapping, f"{name} is not a mapping of names to values")
        unknown = [key for key in value if known and key not in known]
        hint = "known: " + ", ".join(known)
        self.that(not unknown, f"unknown key {', '.join(unknown)} in {name}", hint)
        return dict(value)

    def truth(self, values: Mapping[str, Any], key: str) -> bool:
        value = values.get(key, True)
        self.that(isinstance(value, bool), f"{key} is {value!r}", "true or false")
        return bool(value)

    def name(self, value: Any) -> str:
        name = "" if value is None else str(value)
        good = not name or NAME.fullmatch(name) is not None
        self.that(good, f"station {name!r} is no ROS name", "a letter, then letters, digits, _")
        return name

    def satellites(self, value: Any) -> tuple[str, ...]:
        if value == "all":
            return ALL_SATELLITES
        hint = "all, or a list such as [G05, G12]"
        self.that(isinstance(value, list) and bool(value), f"satellites is {value!r}", hint)
        wrong = [str(item) for item in value if item not in ALL_SATELLITES]
        self.that(not wrong, f"satellites: {', '.join(wrong)} not in G01 to G32", hint)
        return tuple(sorted(set(value)))

    def source(self, values: dict[str, Any]) -> dict[str, Any]:
        """Give the values their types; YAML 1.1 reads 4e6 as text and times as times."""
        texts = ("file", "format", "start_utc")
        whole = ("window_blocks",)
        out: dict[str, Any] = {}
        for key, value in values.items():
            if value is None:
                continue
            kind: type = str if key in texts else int if key in whole else float
            try:
                out[key] = kind(value)
            except (TypeError, ValueError):
                self.that(False, f"source.{key} is {value!r}, not a number")
        if is_live(out.get("file", "")):
            out.setdefault("start_utc", datetime.now(UTC).isoformat(timespec="microseconds"))
        elif out.get("file"):
            out["file"] = str(bag_of(self.beside(out["file"])))
        return out

    def imu(self, values: dict[str, Any]) -> dict[str, Any]:
        """Return the IMU's file, and how it stands if a grade is given here."""
        if not values.get("file"):
            return {}
        out: dict[str, Any] = {"file": str(bag_of(self.beside(values.pop("file"))))}
        if values.get("grade"):
            entries = {key: _entry(value, f"{self.path}: imu") for key, value in values.items()}
            out["installation"] = fill(Installation, Entry(entries, f"{self.path}: imu"))
        return out

    def archive(self, values: dict[str, Any]) -> ArchiveConfig:
        """Return how the recording is cut and what is kept of it."""
        where = f"{self.path}: archive"
        entries = {key: _entry(value, where) for key, value in values.items()}
        config = fill(ArchiveConfig, Entry(entries, where))
        self.that(not config.complaint(), f"archive: {config.complaint()}")
        return config

    def live_page(self, values: dict[str, Any]) -> WebOptions | None:
        """Return where the live page is, if its port is given."""
        port = values.get("port") or 0
        names = values.get("names") or []
        good = isinstance(port, int) and 0 <= port <= 65535
        self.that(good, f"live_page.port is {port!r}", "1 to 65535, or 0 for no page")
        good = isinstance(names, list) and all(isinstance(name, str) for name in names)
        self.that(good, f"live_page.names is {names!r}", "a list such as [station.example.org]")
        if not port:
            return None
        token_file = str(self.beside(values["token_file"])) if values.get("token_file") else ""
        address = str(values.get("address") or WebOptions.address)
        return WebOptions(port, address, token_file, tuple(names))

    def alert(self, values: dict[str, Any]) -> AlertConfig:
        """Return whom to tell of events."""
        where = f"{self.path}: alert"
        entries = {key: _entry(value, where) for key, value in values.items()}
        return checked(fill(AlertConfig, Entry(entries, where)), where)

    def base(self, values: dict[str, Any]) -> dict[str, Any]:
        """Return where the base comes from, and its place if it is given here."""
        given = str(values.get("from") or "")
        if not given:
            return {}
        place = [float(value) for value in values.get("position_ecef") or ()]
        self.that(len(place) in (0, 3), f"base.position_ecef is {place}", "x, y, z in metres")
        found = given if is_address(given) else str(bag_of(self.beside(given)))
        return {"from": found, "position_ecef": place}

    def files(self, parameters: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        """Make the files that parameters name relative to the configuration."""
        for values in parameters.values():
            for key, value in values.items():
                if key.endswith("_file") and value:
                    values[key] = str(self.beside(value))
        return parameters

    def beside(self, name: str) -> Path:
        return (self.path.resolve().parent / Path(name).expanduser()).resolve()


def _entry(value: Any, where: str) -> Entry:
    if isinstance(value, list):
        return Entry([_entry(item, where) for item in value], where)
    return Entry(value, where)
