"""The tutorials as a newcomer types them, from an empty folder beside the command."""

import os
import re
import shlex
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = ROOT / "docs" / "tutorials"
PAGES = sorted(path.stem for path in TUTORIALS.glob("*.md") if path.stem != "index")
LONG = "not in the tutorial's test"


def commands(text: str) -> list[str]:
    """Indented lines that begin with the command, but for those that say that they take long."""
    lines = re.findall(r"^    (\./deepseis .*)$", text, re.MULTILINE)
    return [line for line in lines if LONG not in line]


def files(text: str) -> dict[str, str]:
    """Blocks whose first line names a file."""
    blocks = re.findall(r"^```yaml\n# (\S+\.yaml)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return dict(blocks)


def test_every_tutorial_has_commands_and_stands_in_the_index():
    index = (TUTORIALS / "index.md").read_text()
    for page in PAGES:
        assert commands((TUTORIALS / f"{page}.md").read_text()), page
        assert f"({page}.md)" in index


@pytest.mark.slow
@pytest.mark.launch
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("page", PAGES)
def test_a_tutorial_can_be_typed_as_it_stands(tmp_path, page):
    text = (TUTORIALS / f"{page}.md").read_text()
    (tmp_path / "deepseis").symlink_to(ROOT / "deepseis")
    for name, content in files(text).items():
        (tmp_path / name).write_text(content)
    for command in commands(text):
        result = subprocess.run(
            shlex.split(command),
            cwd=tmp_path,
            env=dict(os.environ),
            capture_output=True,
            text=True,
            timeout=900,
        )
        assert result.returncode == 0, f"{command}\n{result.stdout}\n{result.stderr}"
