"""The checks and tests of the project, as developers and CI run them."""

import os
import subprocess
import sys
import time
from pathlib import Path

import typer

PACKAGES = (
    "deepseis_core",
    "deepseis_frontend",
    "deepseis_tracking",
    "deepseis_pvt",
    "deepseis_ins",
    "deepseis_sim",
    "deepseis_bringup",
)


def project_root() -> Path:
    """Return the checkout that this module was loaded from."""
    for folder in Path(__file__).resolve().parents:
        if (folder / "pyproject.toml").exists():
            return folder
    raise FileNotFoundError("the checks need the checkout: no pyproject.toml above " + __file__)


def steps() -> dict[str, list[str]]:
    """Return the checks, quickest first."""
    mypy = ["mypy", *(argument for package in PACKAGES for argument in ("-p", package))]
    return {
        "ruff check": ["ruff", "check", "."],
        "ruff format": ["ruff", "format", "--check", "."],
        "lint-imports": ["lint-imports"],
        "mypy": mypy,
        "docs": site_command(project_root() / ".build" / "site"),
    }


def site_command(output: Path) -> list[str]:
    """Return the command that builds the site; a link that leads nowhere fails it."""
    docs = project_root() / "docs"
    doctrees = project_root() / ".build" / "doctrees"
    return [
        "sphinx-build",
        "-q",
        "-W",
        "--keep-going",
        "-d",
        str(doctrees),
        str(docs),
        str(output),
    ]


def build_site(output: Path) -> bool:
    """Build the site of docs/ and tell whether it is whole."""
    return _run("docs", site_command(output))


def environment() -> dict[str, str]:
    """Return the environment of the tools: plain text where a machine reads."""
    variables = dict(os.environ)
    if variables.get("CI", "").lower() not in ("", "0", "false"):
        variables.pop("FORCE_COLOR", None)
        variables |= {"NO_COLOR": "1", "PY_COLORS": "0", "TERM": "dumb"}
    return variables


def check() -> bool:
    """Run every check, show each with its time, and tell whether all passed."""
    passed = True
    for name, command in steps().items():
        passed = _run(name, command) and passed
    return passed


def _run(name: str, command: list[str]) -> bool:
    started = time.monotonic()
    result = subprocess.run(
        [str(Path(sys.executable).parent / command[0]), *command[1:]],
        cwd=project_root(),
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    failed = result.returncode != 0
    typer.echo(f"{name:<14}{'FAILED' if failed else 'ok':<8}{time.monotonic() - started:.1f} s")
    if failed:
        typer.echo(result.stdout.rstrip())
    return not failed


TESTS_FAILED = 1
"""Exit status of pytest."""

ALONE = "launch or benchmark"
"""Markers of tests that need the machine to themselves: clocks, and processes of their own."""


def test(arguments: list[str], *, full: bool, skip_check: bool) -> int:
    """Run the checks, then pytest; return the exit status.

    All tests run on two processes, a module's on the same, but for those that need the machine to
    themselves; of these what fails runs once more, from its fixtures on. What is chosen by
    arguments runs in one process, once.
    """
    passed = skip_check or check()
    speed = "" if full else "not slow"
    if arguments:
        statuses = [_pytest(["-m", speed, *arguments] if speed else arguments)]
    else:
        rest = f" and {speed}" if speed else ""
        beside = ["-n", "2", "--dist", "loadscope", "-m", f"not ({ALONE}){rest}"]
        statuses = [_pytest(beside), _twice(["-m", f"({ALONE}){rest}"])]
    return max(statuses, key=abs) or (0 if passed else 1)


def _twice(arguments: list[str]) -> int:
    """Run tests; those that fail once more, after what they failed with has been shown."""
    status = _pytest(arguments)
    if status != TESTS_FAILED:
        return status
    typer.echo("A SECOND TRY of what failed above (docs/decisions/0029): read it all the same")
    return _pytest(["--last-failed", "--last-failed-no-failures", "none", *arguments])


def _pytest(arguments: list[str]) -> int:
    sys.stdout.flush()
    command = [sys.executable, "-m", "pytest", *arguments]
    return subprocess.run(command, cwd=project_root(), env=environment()).returncode
