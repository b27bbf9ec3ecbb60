"""Options of the live page, for the commands that run a graph."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from deepseis_bringup.live.web_options import PORT, WebOptions

WebPort = Annotated[
    int | None,
    typer.Option(
        "--web",
        metavar="[PORT]",
        min=1,
        max=65535,
        help=f"Live page at http://127.0.0.1:PORT/ (default {PORT}); see docs/live-page.md.",
    ),
]
WebAddress = Annotated[
    str | None,
    typer.Option(
        "--web-address",
        help="IP address the page listens on; beyond this machine it needs a token.",
        show_default=False,
    ),
]
WebToken = Annotated[
    Path | None,
    typer.Option(
        "--web-token-file",
        help="File with the page's token; else the environment's DEEPSEIS_WEB_TOKEN.",
    ),
]
WebNames = Annotated[
    list[str] | None,
    typer.Option("--web-name", help="Host name of the page, as of a reverse proxy; repeatable."),
]


def with_default_port(words: Sequence[str]) -> list[str]:
    """Return the command's words with the default port after a ``--web`` that has none.

    Examples
    --------
    >>> with_default_port(["replay", "--web", "runs/a"])
    ['replay', '--web', '8765', 'runs/a']
    >>> with_default_port(["station", "--web", "9000"])
    ['station', '--web', '9000']
    """
    said = list(words)
    for at in range(len(said) - 1, -1, -1):
        after = said[at + 1] if at + 1 < len(said) else ""
        if said[at] == "--web" and not after.isdigit():
            said.insert(at + 1, str(PORT))
    return said


def web_options(
    port: int | None,
    address: str | None,
    token_file: Path | None,
    names: list[str] | None,
    base: WebOptions | None = None,
) -> WebOptions | None:
    """Return what was asked for, over what a station's file says; None: no page."""
    if port is None and base is None:
        return None
    given: dict[str, Any] = {
        "port": port,
        "address": address,
        "token_file": str(token_file) if token_file else None,
        "names": tuple(names) if names else None,
    }
    values = vars(base) if base is not None else {}
    return WebOptions(**{**values, **{k: v for k, v in given.items() if v is not None}})
