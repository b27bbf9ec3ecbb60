"""Where a bag lies. Imports nothing else: every command starts with it."""

from __future__ import annotations

from pathlib import Path


def bag_of(path: Path) -> Path:
    """Return the bag of a run's folder, or the path itself."""
    inside = path / "bag"
    return inside if inside.is_dir() and not any(path.glob("*.mcap")) else path
