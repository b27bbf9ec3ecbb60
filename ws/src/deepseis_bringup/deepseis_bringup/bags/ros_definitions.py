"""What a bag says about its topics: definition and hash of the type, quality of service."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import yaml

from deepseis_core.errors import InputError

BUILTIN: Final = re.compile(r"bool|byte|char|w?string|float(32|64)|u?int(8|16|32|64)")
SEPARATOR: Final = "=" * 80
FOREVER: Final = {"sec": 9223372036, "nsec": 854775807}
FIELD: Final = re.compile(r"^([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]\w*")
CONSTANT: Final = re.compile(r"^\S+\s+[A-Za-z]\w*\s*=")


@dataclass(frozen=True)
class TopicQos:
    """Quality of service that a publisher offers."""

    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "keep_last"
    depth: int = 10
    liveliness: str = "automatic"

    def to_dict(self) -> dict[str, Any]:
        """Return the form of ``metadata.yaml`` version 9."""
        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": dict(FOREVER),
            "lifespan": dict(FOREVER),
            "liveliness": self.liveliness,
            "liveliness_lease_duration": dict(FOREVER),
            "avoid_ros_namespace_conventions": False,
        }

    def to_yaml(self) -> str:
        """Return the text that stands in an MCAP channel."""
        return yaml.safe_dump([self.to_dict()], sort_keys=False)


class Definitions:
    """Message definitions: those given, else the installed ones (ament index).

    Parameters
    ----------
    given : mapping, optional
        Text of ``.msg`` files by type name, such as ``"std_msgs/msg/Header"``.
    """

    def __init__(self, given: Mapping[str, str] | None = None) -> None:
        self._texts = dict(given or {})
        self._hashes = dict.fromkeys(self._texts, "")

    def text(self, type_name: str) -> str:
        """Return the text of a type's ``.msg`` file.

        Raises
        ------
        InputError
            Where the type is neither given nor installed.
        """
        if type_name not in self._texts:
            path = _installed(type_name)
            if path is None:
                raise InputError(type_name, "is not an installed message", "build the workspace")
            self._texts[type_name] = path.read_text(encoding="utf-8")
        return self._texts[type_name]

    def schema(self, type_name: str) -> bytes:
        """Return a ``ros2msg`` schema: the definition, then those of all types it uses."""
        parts = [self.text(type_name)]
        seen = {type_name}
        waiting = _dependencies(type_name, parts[0])
        while waiting:
            name = waiting.pop(0)
            if name in seen:
                continue
            seen.add(name)
            text = self.text(name)
            package, _, message = name.split("/")
            parts.append(f"{SEPARATOR}\nMSG: {package}/{message}\n{text}")
            waiting += _dependencies(name, text)
        return "\n".join(part.rstrip("\n") for part in parts).encode() + b"\n"

    def type_hash(self, type_name: str) -> str:
        """Return the RIHS01 hash of an installed type; of a given one an empty text."""
        if type_name not in self._hashes:
            self._hashes[type_name] = _installed_hash(type_name)
        return self._hashes[type_name]


def _dependencies(type_name: str, text: str) -> list[str]:
    """Full names of the types that a definition uses, in order."""
    package = type_name.split("/")[0]
    names = []
    for line in text.splitlines():
        line = line.partition("#")[0].strip()
        match = FIELD.match(line)
        if match is None or CONSTANT.match(line) or BUILTIN.fullmatch(match[1]):
            continue
        words = match[1].split("/")
        names.append(f"{words[0] if len(words) > 1 else package}/msg/{words[-1]}")
    return names


def _installed(type_name: str, suffix: str = ".msg") -> Path | None:
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

    words = type_name.split("/")
    if len(words) != 3:
        raise InputError(type_name, "is no type name", "such as std_msgs/msg/Header")
    try:
        folder = Path(get_package_share_directory(words[0]))
    except (PackageNotFoundError, LookupError, ValueError, OSError):  # or no ROS is set up
        return None
    path = folder / words[1] / f"{words[2]}{suffix}"
    return path if path.is_file() else None


def _installed_hash(type_name: str) -> str:
    path = _installed(type_name, ".json")
    if path is None:
        return ""
    entries = json.loads(path.read_text(encoding="utf-8")).get("type_hashes", [])
    found = [e["hash_string"] for e in entries if e["type_name"] == type_name]
    return found[0] if found else ""
