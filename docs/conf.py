"""Sphinx settings of the site (`./deepseis docs`); the pages read well without it."""

from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parent.parent
MESSAGES = ROOT / "ws" / "src" / "deepseis_msgs" / "msg"

project = "DeepSeis"
author = "DeepSeis developers"
version = yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"]
copyright = "DeepSeis developers, Apache-2.0"

extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = "DeepSeis"
html_show_sphinx = False
html_copy_source = False
pygments_style = "default"
highlight_language = "none"


def commands_page() -> str:
    """Return the page of all commands, made of what `--help` prints."""
    import typer
    from typer.testing import CliRunner

    from deepseis_bringup.cli import app

    group = typer.main.get_command(app)
    runner = CliRunner()
    names = sorted(group.commands)  # type: ignore[attr-defined]
    parts = [
        "# Commands",
        "",
        "What `./deepseis COMMAND --help` says, made when the site is built.",
        "",
    ]
    for name in names:
        text = runner.invoke(app, [name, "--help"], prog_name="./deepseis").output
        parts += [f"## {name}", "", "```text", text.rstrip(), "```", ""]
    return "\n".join(parts)


def messages_page() -> str:
    """Return the page of all messages: the files themselves, whose comments state the units."""
    parts = [
        "# Messages",
        "",
        "The files of `ws/src/deepseis_msgs/msg`, made when the site is built.",
        "",
    ]
    for path in sorted(MESSAGES.glob("*.msg")):
        parts += [f"## {path.stem}", "", "```text", path.read_text().rstrip(), "```", ""]
    return "\n".join(parts)


def make_reference(app: object) -> None:
    """Write the pages that are made from the program; unchanged ones keep their date."""
    folder = Path(__file__).parent / "reference"
    folder.mkdir(exist_ok=True)
    from deepseis_bringup.parameter_table import parameters_page

    pages = (
        ("commands", commands_page),
        ("messages", messages_page),
        ("parameters", parameters_page),
    )
    for name, page in pages:
        path, text = folder / f"{name}.md", page() + "\n"
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def setup(app: "sphinx.application.Sphinx") -> None:  # type: ignore[name-defined]  # noqa: F821
    """Have the pages made before any is read."""
    app.connect("builder-inited", make_reference)
