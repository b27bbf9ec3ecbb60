"""Where a run's live page is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from deepseis_bringup.listening import listening
from deepseis_bringup.live.guard import Guard, token_from

PORT: Final = 8765
PAGE: Final = "live page", "choose another with --web PORT"
"""Whose port it is, and what to do where it is taken."""


@dataclass(frozen=True)
class WebOptions:
    """As the parameters of the page's node (`deepseis_bringup.nodes.web.WebConfig`)."""

    port: int = PORT
    address: str = "127.0.0.1"
    token_file: str = ""
    names: tuple[str, ...] = ()

    def check(self) -> None:
        """Find out at once whether the page can be served.

        Raises
        ------
        InputError
            The port is taken, or a token is missing.
        """
        Guard(self.address, token_from(self.token_file), self.names)
        listening(self.address, self.port, *PAGE).close()

    @property
    def url(self) -> str:
        """What to open on this machine.

        Examples
        --------
        >>> WebOptions(9000, "0.0.0.0").url
        'http://127.0.0.1:9000/'
        """
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.address, self.address)
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/"
