"""Which generation of messages a recording holds: read what is ours, refuse the rest by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from deepseis_core.errors import InputError

INTERFACE_VERSION: Final = "2"
"""Raised by one with every change of a message that an older reader would misread."""

RECORD: Final = "deepseis"
"""Name of the MCAP metadata record, and of its key's owner in ``metadata.yaml``."""

KEY: Final = "interface_version"

SHARED_TOPICS: Final = frozenset({"acquisition/request", "gnss/ephemeris", "/diagnostics"})
"""Topics on which several nodes publish: counted in watermarks, put in order by the recorder."""


def require_interface(path: object, records: Mapping[str, Mapping[str, str]]) -> None:
    """Refuse a recording of another interface version, or of none.

    Parameters
    ----------
    path : path
        The recording, for the message.
    records : mapping
        Its MCAP metadata records, by name.

    Raises
    ------
    InputError
        Naming both versions.

    Examples
    --------
    >>> require_interface("a.mcap", {"deepseis": {"interface_version": "2"}})
    """
    version = records.get(RECORD, {}).get(KEY)
    if version is None:
        raise InputError(path, "has no DeepSeis interface version: another program recorded it")
    if version != INTERFACE_VERSION:
        raise InputError(
            path,
            f"was recorded with interface version {version}, this is version {INTERFACE_VERSION}",
            "replay it with the DeepSeis that recorded it",
        )
