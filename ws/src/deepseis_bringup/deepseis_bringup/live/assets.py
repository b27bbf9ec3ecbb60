"""The files of the live page, read once: no request reaches the disk."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

PAGE: Final = Path(__file__).with_name("page")
TYPES: Final[Mapping[str, str]] = {
    ".html": "text/html",
    ".css": "text/css",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
}
OPEN: Final = frozenset({"style.css", "login.js", "icon.svg"})
"""What the form for the token needs: given to everybody."""


@dataclass(frozen=True)
class Asset:
    """A file: its bytes, type and tag."""

    data: bytes
    content_type: str
    tag: str


def read_assets(folder: Path = PAGE) -> dict[str, Asset]:
    """Return the page's files by name."""
    found = {}
    for path in sorted(folder.iterdir()):
        if path.suffix in TYPES:
            data = path.read_bytes()
            tag = hashlib.sha256(data).hexdigest()[:16]
            found[path.name] = Asset(data, TYPES[path.suffix], tag)
    return found


def digest(assets: Mapping[str, Asset]) -> str:
    """Return what changes when any file does: an open page then loads itself anew."""
    tags = "".join(asset.tag for _, asset in sorted(assets.items()))
    return hashlib.sha256(tags.encode()).hexdigest()[:16]
