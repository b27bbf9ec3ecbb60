"""Settings from YAML: frozen dataclasses filled from a file, complaints with file and line.

A file's mapping fills a dataclass whose fields are declared by `deepseis_core.config.setting`;
keys are the fields' names. A field may hold a number, text, true/false, a list of these, another
such dataclass, or a list of them; where several kinds are possible the entry says ``kind: name``.
What is left out keeps its default; ``false`` takes away an optional part.
"""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml

from deepseis_core.config import check
from deepseis_core.errors import InputError

Settings = TypeVar("Settings")
Kinds = Mapping[Any, Mapping[str, type]]
"""For an annotation (a protocol, a union): the dataclasses that an entry's ``kind`` may name."""

LARGEST = 1_000_000
_DEEPEST = 20
_MOST = 100_000
"""Values of one file, those that aliases repeat counted each time."""


@dataclasses.dataclass(frozen=True)
class Entry:
    """A value of a YAML file and where it stands.

    ``value`` is a text, a number, true, false, None, a list of entries, or a mapping of names to
    entries; ``where`` is the file and line, as complaints give them.
    """

    value: Any
    where: str

    def plain(self) -> Any:
        """Return the value without places."""
        if isinstance(self.value, dict):
            return {key: entry.plain() for key, entry in self.value.items()}
        if isinstance(self.value, list):
            return [entry.plain() for entry in self.value]
        return self.value


def read_yaml(path: str | Path) -> Entry:
    """Read a YAML file whose top is a mapping.

    Raises
    ------
    InputError
        Where it cannot be read, is no YAML, or has a key twice.
    """
    path = Path(path)
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(path, f"is longer than {LARGEST} bytes", "name a YAML file")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(path, error.strerror or str(error)) from None
    except UnicodeDecodeError:
        raise InputError(path, "is not text", "name a YAML file") from None
    return parse_yaml(text, path)


def parse_yaml(text: str, name: object) -> Entry:
    """Read YAML text; see `read_yaml`.

    Examples
    --------
    >>> entry = parse_yaml("a: 1", "x.yaml")
    >>> entry.plain(), entry.value["a"].where
    ({'a': 1}, 'x.yaml:1')
    """
    try:
        loader = yaml.SafeLoader(text)
        node = loader.get_single_node()
        left = iter(range(_MOST))
        first = Entry({}, f"{name}:1")
        entry = first if node is None else _entry(loader, node, str(name), 0, left)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{name}:{mark.line + 1}" if mark else str(name)
        raise InputError(where, f"is not YAML: {error.problem or error}") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InputError(name, f"is not YAML: {str(error).splitlines()[0]}") from None
    if not isinstance(entry.value, dict):
        raise InputError(entry.where, "is not a mapping of names to values")
    return entry


def _entry(
    loader: yaml.SafeLoader, node: yaml.Node, name: str, depth: int, left: Iterator[int]
) -> Entry:
    where = f"{name}:{node.start_mark.line + 1}"
    if depth > _DEEPEST:
        raise InputError(where, f"is nested deeper than {_DEEPEST}")
    if next(left, None) is None:
        raise InputError(where, f"holds more than {_MOST} values")
    if isinstance(node, yaml.SequenceNode):
        return Entry([_entry(loader, item, name, depth + 1, left) for item in node.value], where)
    if isinstance(node, yaml.MappingNode):
        out: dict[str, Entry] = {}
        for key_node, value in node.value:
            key = key_node.value
            at = f"{name}:{key_node.start_mark.line + 1}"
            if not isinstance(key, str):
                raise InputError(at, "has a key that is no name")
            if key in out:
                raise InputError(at, f"{key} is given twice")
            out[key] = dataclasses.replace(_entry(loader, value, name, depth + 1, left), where=at)
        return Entry(out, where)
    return Entry(loader.construct_object(node), where)  # type: ignore[no-untyped-call]


def overlay(base: Entry, more: Entry) -> Entry:
    """Put one tree over another: mappings are merged, anything else is replaced."""
    if not (isinstance(base.value, dict) and isinstance(more.value, dict)):
        return more
    if "kind" in more.value and "kind" in base.value:
        return more
    merged = dict(base.value)
    for key, entry in more.value.items():
        merged[key] = overlay(merged[key], entry) if key in merged else entry
    return Entry(merged, base.where)


def override(base: Entry, text: str) -> Entry:
    """Change one value by ``a.b=value``, as given on a command line.

    Examples
    --------
    >>> override(parse_yaml("imu: {rate_hz: 200}", "x"), "imu.rate_hz=100").plain()
    {'imu': {'rate_hz': 100}}
    >>> override(parse_yaml("motion: [{radius: 1}]", "x"), "motion.0.radius=2").plain()
    {'motion': [{'radius': 2}]}
    """
    path, equals, value = text.partition("=")
    names = path.strip().split(".")
    if not equals or not all(names):
        raise InputError(f"--set {text}", "is not NAME=VALUE", "such as imu.grade=mti-g")
    where = f"--set {text}"
    holder = parse_yaml(f"value: {value}", where).value["value"]
    return _replaced(base, names, Entry(holder.value, where))


def _replaced(base: Entry, names: list[str], new: Entry) -> Entry:
    """Put a value in its place; mappings that are not there yet are made."""
    if not names:
        return overlay(base, new)
    name, rest = names[0], names[1:]
    if isinstance(base.value, list):
        if not name.isdecimal() or int(name) >= len(base.value):
            raise InputError(new.where, f"{name} is none of {len(base.value)}, counted from 0")
        items = list(base.value)
        items[int(name)] = _replaced(items[int(name)], rest, new)
        return Entry(items, base.where)
    values = dict(base.value) if isinstance(base.value, dict) else {}
    values[name] = _replaced(values.get(name, Entry(None, new.where)), rest, new)
    return Entry(values, base.where)


def fill(kind: type[Settings], entry: Entry, kinds: Kinds | None = None) -> Settings:
    """Make a settings dataclass from a mapping.

    Parameters
    ----------
    kind : type
        The dataclass.
    entry : Entry
        Of a mapping.
    kinds : mapping, optional
        See `Kinds`.

    Raises
    ------
    InputError
        Names file, line, key and reason.
    """
    values = _mapping(entry)
    known = {item.name: item for item in dataclasses.fields(kind) if item.init}  # type: ignore[arg-type]
    for key, value in values.items():
        if key not in known:
            raise InputError(value.where, f"{key} is not known", "known: " + ", ".join(known))
    hints = typing.get_type_hints(kind)
    made = {key: _value(hints[key], value, key, kinds or {}) for key, value in values.items()}
    missing = [name for name, item in known.items() if name not in made and _needed(item)]
    if missing:
        raise InputError(entry.where, f"{', '.join(missing)} is missing")
    result = kind(**made)
    try:
        check(result)
    except ValueError as error:
        at = next((values[key].where for key in values if str(error).startswith(f"{key} ")), "")
        raise InputError(at or entry.where, str(error)) from None
    return result


def _needed(item: dataclasses.Field[Any]) -> bool:
    missing = dataclasses.MISSING
    return item.default is missing and item.default_factory is missing


def _mapping(entry: Entry) -> dict[str, Entry]:
    value = {} if entry.value is None else entry.value
    if not isinstance(value, dict):
        raise InputError(entry.where, f"{entry.plain()!r} is not a mapping of names to values")
    return value


def _value(hint: Any, entry: Entry, key: str, kinds: Kinds) -> Any:
    """Turn an entry into a field's value."""
    if hint in kinds:
        return _one_of(kinds[hint], entry, key, kinds)
    if dataclasses.is_dataclass(hint):
        return fill(typing.cast(type, hint), entry, kinds)
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        if entry.value is False:
            return None
        (inner,) = [item for item in arguments if item is not type(None)]
        return _value(inner, entry, key, kinds)
    if origin is tuple:
        if not isinstance(entry.value, list):
            raise InputError(entry.where, f"{key} is {entry.plain()!r}, not a list")
        inner_hints: Iterable[Any] = arguments
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            inner_hints = [arguments[0]] * len(entry.value)
        elif len(arguments) != len(entry.value):
            raise InputError(entry.where, f"{key} has {len(entry.value)}, not {len(arguments)}")
        pairs = zip(inner_hints, entry.value, strict=True)
        return tuple(_value(inner, item, key, kinds) for inner, item in pairs)
    return _scalar(hint, entry, key)


def _one_of(choices: Mapping[str, type], entry: Entry, key: str, kinds: Kinds) -> Any:
    values = dict(_mapping(entry))
    hint = "known: " + ", ".join(choices)
    if "kind" not in values:
        raise InputError(entry.where, f"{key} has no kind", hint)
    named = values.pop("kind")
    if not isinstance(named.value, str) or named.value not in choices:
        raise InputError(named.where, f"kind {named.plain()!r} of {key} is not known", hint)
    return fill(choices[named.value], Entry(values, entry.where), kinds)


def _scalar(hint: Any, entry: Entry, key: str) -> Any:
    what = "no text" if hint is str else "no number"
    value, wrong = entry.value, InputError(entry.where, f"{key} is {entry.plain()!r}, {what}")
    if hint is bool:
        if not isinstance(value, bool):
            raise InputError(entry.where, f"{key} is {entry.plain()!r}, not true or false")
        return value
    if isinstance(value, (bool, dict, list)) or (value is None and hint is not str):
        raise wrong
    if hint is str:
        return "" if value is None else str(value)
    try:
        number = float(value)  # YAML 1.1 reads 4e6 as text
        whole = int(value) if isinstance(value, int) else int(number)
    except (TypeError, ValueError, OverflowError):
        raise wrong from None
    if math.isnan(number):
        raise wrong
    if hint is int:
        if whole != number:
            raise InputError(entry.where, f"{key} is {value!r}, not a whole number")
        return whole
    return number
