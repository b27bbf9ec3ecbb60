"""Find and start the nodes' executables, without needing `ros2 run`."""

import os
from pathlib import Path
from typing import NoReturn

from ament_index_python import get_package_prefix, get_packages_with_prefixes
from ament_index_python.packages import PackageNotFoundError


class UnknownExecutableError(LookupError):
    """No such package, or no such node in it; the message lists what there is."""


def executables(package: str) -> dict[str, Path]:
    """Return the executables of an installed package, by name."""
    try:
        folder = Path(get_package_prefix(package)) / "lib" / package
    except (PackageNotFoundError, ValueError):
        raise UnknownExecutableError(
            f"there is no package '{package}'; with nodes there are: {', '.join(packages())}"
        ) from None
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    return {path.name: path for path in files if path.is_file() and os.access(path, os.X_OK)}


def packages() -> list[str]:
    """Return the DeepSeis packages that have executables."""
    installed = (name for name in get_packages_with_prefixes() if name.startswith("deepseis_"))
    return sorted(name for name in installed if executables(name))


def executable(package: str, node: str) -> Path:
    """Return the path of a node's executable."""
    found = executables(package)
    if node not in found:
        known = ", ".join(found) or "none"
        raise UnknownExecutableError(f"there is no node '{node}' in {package}; there are: {known}")
    return found[node]


def become(package: str, node: str, arguments: list[str]) -> NoReturn:
    """Replace this process by a node."""
    path = executable(package, node)
    os.execv(path, [str(path), *arguments])
