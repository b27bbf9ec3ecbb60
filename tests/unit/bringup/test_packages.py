"""package.xml of every package against what its modules import."""

import ast
import re
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

SOURCES = Path(__file__).resolve().parents[3] / "ws/src"
PACKAGES = sorted(path.parent.name for path in SOURCES.glob("*/setup.py"))
APT = {
    "numpy": "python3-numpy",
    "aiohttp": "python3-aiohttp",
    "scipy": "python3-scipy",
    "yaml": "python3-yaml",
} | {"rich": "python3-rich"}
COMES_WITH = {"llvmlite": "numba", "builtin_interfaces": "std_msgs", "launch_ros": "launch"}


def imports(package):
    found = set()
    for path in (SOURCES / package / package).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                found.add(node.module.partition(".")[0])
    return found - set(sys.stdlib_module_names) - {package}


@pytest.mark.parametrize("package", PACKAGES)
def test_every_import_is_declared(package):
    text = (SOURCES / package / "package.xml").read_text()
    declared = {item.text for item in ElementTree.fromstring(text).iter("exec_depend")}
    comment = re.search(r"from PyPI \(requirements\.lock\): ([^.]+)\.", text)
    declared |= set(comment[1].split(", ")) if comment else set()
    needed = {COMES_WITH.get(name, APT.get(name, name)) for name in imports(package)}
    assert needed <= declared


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_depend_downwards_only(package):
    text = (SOURCES / package / "package.xml").read_text()
    ours = set(re.findall(r">(deepseis_\w+)<", text)) - {package}
    allowed = {"deepseis_msgs"} | ({"deepseis_core"} if package != "deepseis_core" else set())
    assert ours <= (allowed if package != "deepseis_bringup" else {*PACKAGES, "deepseis_msgs"})
