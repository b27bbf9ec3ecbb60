"""What the documents name is there: commands with their options, files, modules."""

import re
import shlex
from fnmatch import fnmatch
from pathlib import Path

import pytest
import typer

from deepseis_bringup.cli import app
from deepseis_bringup.commands.web import with_default_port

ROOT = Path(__file__).resolve().parents[3]
SOURCE = ROOT / "ws" / "src"
PAGES = [
    *(ROOT / name for name in ("README.md", "docker/README.md")),
    *sorted(path for path in (ROOT / "docs").rglob("*.md") if path.parent.name != "reference"),
]
HELP = sorted(SOURCE.glob("deepseis_bringup/deepseis_bringup/commands/*.py"))
COMMANDS = typer.main.get_command(app)
OF_THE_BOOTSTRAP = {"python", "env"}
STANDS_FOR = {"HZ": "4e6"}
EXAMPLES = {"test_<module>.py", "nodes/name.py", "ws/src/deepseis_msgs/msg/Name.msg"}


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def commands(text: str) -> list[str]:
    """Return all that follows ``./deepseis`` in code: lines of their own, or between backticks."""
    lines = re.findall(r"^ {4,}\./deepseis (.+)$", text, re.MULTILINE)
    inline = re.findall(r"(?<!`)`\./deepseis ([^`\n]+)`", text)
    return [re.sub(r"\s+#.*$", "", line) for line in lines] + inline


def words(command: str) -> list[str]:
    """Return a command's words: optional ones are taken, redirections left away.

    Examples
    --------
    >>> words("process FILE --rate HZ [--web] > out.txt")
    ['process', 'FILE', '--rate', '4e6', '--web']
    """
    said = [word.strip("[]") for word in shlex.split(re.split(r" [>|]| <<", command)[0])]
    return [STANDS_FOR.get(word, word.removesuffix("...") or word) for word in said]


def refusal(said: list[str]) -> str:
    """Return why the command's own parser refuses words, empty if it does not; run nothing.

    A command's name alone is how the documents speak of it: what it needs may lack then.
    """
    try:
        words = with_default_port(said)
        context = COMMANDS.make_context("deepseis", list(words))
        name, command, rest = COMMANDS.resolve_command(context, words)  # type: ignore[attr-defined]
        command.make_context(name, rest, parent=context)
    except Exception as error:  # the parser's own, whose classes typer keeps to itself
        kind = type(error).__name__
        if getattr(error, "exit_code", 1) == 0:  # --help
            return ""
        if kind == "MissingParameter" and len(said) == 1:
            return ""
        return f"{kind}: {getattr(error, 'message', error)}"
    return ""


def test_every_command_that_is_shown_is_understood():
    shown = [
        (f"{page.name}: {command}", command)
        for page in PAGES + HELP
        for command in commands(text_of(page))
        if command.split()[0] not in OF_THE_BOOTSTRAP
    ]
    assert len(shown) > 100
    wrong = [f"{line}: {why}" for line, command in shown if (why := refusal(words(command)))]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("name", sorted(COMMANDS.commands))  # type: ignore[attr-defined]
def test_every_command_takes_its_own_defaults(name):
    """A default outside of an option's own limits would make the option a must."""
    said = [name]
    for param in COMMANDS.commands[name].params:  # type: ignore[attr-defined]
        if param.required:
            said += [*param.opts[:1], "a"] if param.param_type_name == "option" else ["a"]
    assert refusal(said) == ""


@pytest.mark.parametrize("command", ["walk runs/a", "replay runs/a --fast", "sim --rate HIGH"])
def test_a_command_that_is_not_there_would_be_noticed(command):
    assert refusal(words(command))


def project_files() -> list[str]:
    """Return the files of the project's folders, from its root."""
    folders = ("benchmarks", "docker", "docs", "ops", "tests", "tools", "ws/src")
    found = [path for name in folders for path in (ROOT / name).rglob("*") if path.is_file()]
    return [str(path.relative_to(ROOT)) for path in found]


def test_every_source_file_that_is_named_is_there():
    files, gone, seen = project_files(), [], 0
    for page in PAGES:
        code = " ".join(re.findall(r"`([^`\n]+)`", text_of(page)))
        for name in re.findall(r"[\w./*<>-]+\.(?:py|msg|js|css|toml|service|timer)\b", code):
            seen += 1
            found = any(fnmatch(f"/{file}", f"*/{name.removeprefix('./')}") for file in files)
            if not found and name not in EXAMPLES:
                gone.append(f"{page.name}: {name}")
    assert seen > 100
    assert not gone, "\n".join(gone)


def test_every_algorithm_stands_where_the_list_of_sources_says():
    files, gone, seen = project_files(), [], 0
    for line in text_of(ROOT / "docs" / "references.md").splitlines():
        package = ""
        for named, module in re.findall(r"`(\w+)`: |`([\w*]+)`", line):
            package = named or package
            if not module or not package:
                continue
            seen += 1
            where = f"ws/src/deepseis_{package}/*/{module}.py"
            if not any(fnmatch(file, where) for file in files):
                gone.append(f"{package}: {module}")
    assert seen > 30
    assert not gone, "\n".join(gone)
