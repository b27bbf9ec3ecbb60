"""The page of all nodes' parameters, made from what the nodes declare.

A node declares settings dataclasses by ``declare(self, SomeConfig)``; these calls are read from
the source of its module and of those of the same folder that it imports.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import importlib.util
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

PACKAGES: Final = (
    *("deepseis_frontend", "deepseis_tracking", "deepseis_pvt", "deepseis_ins"),
    "deepseis_bringup",
)


@dataclass(frozen=True)
class SettingRow:
    """One parameter of a node; ``unit`` is at the end of the description."""

    name: str
    default: Any
    description: str
    low: float | None
    high: float | None
    choices: tuple[str, ...]


def executables() -> list[tuple[str, str]]:
    """Return package and executable of every node, in the order of the graph."""
    found = []
    for package in PACKAGES:
        folder = _source(package, "nodes.__init__").parent
        for path in sorted(folder.glob("*.py")):
            text = path.read_text(encoding="utf-8")
            if "\ndef main()" in text and "declare" in text + _host(path, text):
                found.append((package, path.stem))
    return found


def declared_settings(package: str, executable: str) -> list[SettingRow]:
    """Return the parameters of a node, dataclass by dataclass as it declares them."""
    rows: dict[str, SettingRow] = {}
    for config in _configs(f"{package}.nodes.{executable}", set()):
        for item in dataclasses.fields(config):
            known = item.metadata
            default = item.default
            if default is dataclasses.MISSING and item.default_factory is not dataclasses.MISSING:
                default = item.default_factory()
            rows[item.name] = SettingRow(
                item.name,
                default,
                str(known.get("description", "")),
                known.get("low"),
                known.get("high"),
                tuple(known.get("choices") or ()),
            )
    return list(rows.values())


def parameters_page() -> str:
    """Return the page."""
    parts = [
        "# Parameters",
        "",
        "Of every node, with defaults, limits and units; made from the program. In a station's",
        "file they stand under `parameters: <kind>:`; all are read-only while a node runs, but",
        "for `hypocentre` of `seismic_event`.",
        "",
    ]
    for package, executable in executables():
        parts += [f"## {executable}", "", f"`ros2 run {package} {executable}`", ""]
        parts += ["| Parameter | Default | Limits | What |", "|---|---|---|---|"]
        parts += [_row(item) for item in declared_settings(package, executable)]
        parts.append("")
    return "\n".join(parts)


def _row(item: SettingRow) -> str:
    limits = ", ".join(f"`{c}`" for c in item.choices if c)
    if item.low is not None or item.high is not None:
        low = "" if item.low is None else f"{item.low:g}"
        high = "" if item.high is None else f"{item.high:g}"
        limits = f"{low} ... {high}"
    text = item.description.replace("|", "\\|").replace("<", "\\<")
    return f"| `{item.name}` | `{item.default!r}` | {limits} | {text} |"


def _source(package: str, module: str) -> Path:
    found = importlib.util.find_spec(f"{package}.{module.removesuffix('.__init__')}")
    if found is None or found.origin is None:
        raise FileNotFoundError(f"no {package}.{module}")
    return Path(found.origin)


def _host(path: Path, text: str) -> str:
    """Return the source of what a node's module imports from its own folder."""
    out = ""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module and ".nodes." in node.module:
            beside = path.parent / f"{node.module.rpartition('.')[2]}.py"
            out += beside.read_text(encoding="utf-8") if beside.is_file() else ""
    return out


def _configs(name: str, seen: set[str]) -> Iterator[Any]:
    """Yield the dataclasses that a module, and those of its folder it imports, declare."""
    if name in seen:
        return
    seen.add(name)
    module = importlib.import_module(name)
    tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
    folder = name.rpartition(".")[0]
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(folder + "."):
            yield from _configs(str(node.module), seen)
        is_call = isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        if is_call and node.func.id == "declare" and len(node.args) > 1:  # type: ignore[attr-defined]
            chosen = node.args[1]  # type: ignore[attr-defined]
            config = getattr(module, chosen.id, None) if isinstance(chosen, ast.Name) else None
            if dataclasses.is_dataclass(config):
                yield config
