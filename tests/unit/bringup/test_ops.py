"""What operators install: systemd units, the Foxglove layout, the table of parameters."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import typer

from deepseis_bringup.cli import app
from deepseis_bringup.graph import TYPES, GraphConfig, build_graph
from deepseis_bringup.parameter_table import declared_settings, executables, parameters_page

ROOT = Path(__file__).resolve().parents[3]
OPS = ROOT / "ops"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here")
def test_systemd_has_nothing_to_say_of_the_units(tmp_path):
    for path in OPS.iterdir():
        if path.suffix in (".service", ".timer"):
            # the checkout is not in /opt here, and there is no user of that name
            text = path.read_text().replace("/opt/deepseis", str(ROOT))
            text = text.replace("=deepseis\n", "=root\n")
            (tmp_path / path.name.replace("@.", "@test.")).write_text(text)
    units = sorted(tmp_path.iterdir())
    assert len(units) == 4
    said = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", *map(str, units)],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    ours = [line for line in said.stderr.splitlines() if "deepseis" in line]
    assert not ours, ours


def layout():
    return json.loads((OPS / "foxglove-layout.json").read_text())


def paths(value):
    """All message paths and topics of a layout."""
    if isinstance(value, dict):
        for key, item in value.items():
            if key in ("value", "topic", "topicPath", "path") and isinstance(item, str) and item:
                yield item
            else:
                yield from paths(item)
        if "topics" in value and isinstance(value["topics"], dict):
            yield from value["topics"]
    elif isinstance(value, list):
        for item in value:
            yield from paths(item)


def test_every_topic_and_field_of_the_foxglove_layout_exists():
    from importlib import import_module

    found = [path for path in paths(layout()["configById"]) if path.startswith("/")]
    assert len(found) > 12
    for path in found:
        topic, *fields = path.split(".")
        known = TYPES[topic if topic == "/diagnostics" else topic.lstrip("/")]
        package, _, name = known[0].split("/")
        message = getattr(import_module(f"{package}.msg"), name)()
        for field in fields:
            field = field.partition("[")[0]
            assert field in message.get_fields_and_field_types(), path
            message = getattr(message, field)


def test_every_panel_of_the_layout_is_placed():
    whole = layout()
    placed = json.dumps(whole["layout"])
    assert whole["configById"]
    assert all(f'"{name}"' in placed for name in whole["configById"])


def test_the_table_has_every_executable_and_what_its_node_declares():
    source = {"file": "a", "format": "iq8", "sample_rate_hz": 4e6}
    config = GraphConfig(source, 4e6, aiding="fusion", base=True, record_dir="r")
    page = parameters_page()
    for spec in build_graph(config):
        names = {item.name for item in declared_settings(spec.package, spec.executable)}
        assert set(spec.parameters) <= names, spec.executable
        assert f"## {spec.executable}" in page
    assert len(executables()) >= 10


def test_every_number_has_its_unit():
    without = {
        f"{executable}.{item.name}"
        for package, executable in executables()
        for item in declared_settings(package, executable)
        if type(item.default) is float and "[" not in item.description
    }
    assert not without


def test_the_exporters_unit_gives_options_that_the_command_knows():
    unit = (OPS / "deepseis-export@.service").read_text()
    (start,) = re.findall(r"^ExecStart=/opt/deepseis/deepseis (.*)$", unit, re.MULTILINE)
    (example,) = re.findall(r"EXPORT_OPTIONS=(.*)$", unit, re.MULTILINE)
    words = start.replace("$EXPORT_OPTIONS", example).replace("%i", "kobe").split()
    group = typer.main.get_command(app)
    context = group.make_context("deepseis", list(words))
    name, command, rest = group.resolve_command(context, words)
    given = command.make_context(name, rest, parent=context).params
    assert (given["station"], given["datalink"]) == ("KOBE", "localhost:16000")
