"""Who may look at the live page: addresses, names, the token.

A page on a loopback address needs no token. Everywhere else, and where the page is known by a
name (a reverse proxy's), one is required. Another site's pages cannot read ours: a request's Host
has to be an address or a name that was given (a rebound DNS name is neither), and the Origin of a
live connection has to be the page's own.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from deepseis_core.errors import InputError

TOKEN_VARIABLE: Final = "DEEPSEIS_WEB_TOKEN"
"""Environment variable that may hold the token."""
SHORTEST_TOKEN: Final = 16
"""Characters that a token has at least."""
HEADERS: Final[Mapping[str, str]] = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
        "connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Cache-Control": "no-cache",
}
"""Sent with every answer."""


def token_from(file: str, environment: Mapping[str, str] = os.environ) -> str:
    """Return the token of a file, else of the environment; empty: none.

    Raises
    ------
    InputError
        The file cannot be read, or the token is short.
    """
    where, token = TOKEN_VARIABLE, environment.get(TOKEN_VARIABLE, "").strip()
    if file:
        where = file
        try:
            token = Path(file).read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "is no text"
            raise InputError(file, f"cannot be read as a token: {reason}") from None
    hint = "make one: head -c 24 /dev/urandom | base64"
    if (file or token) and len(token) < SHORTEST_TOKEN:
        raise InputError(where, f"the token has fewer than {SHORTEST_TOKEN} characters", hint)
    return token


@dataclass(frozen=True)
class Guard:
    """Decides about requests.

    Parameters
    ----------
    address : str
        Where the server listens, an IP address.
    token : str
        Empty: none is required.
    names : tuple of str
        Names by which the page is known besides localhost.

    Raises
    ------
    InputError
        The address is none, or a token is required and there is none.

    Examples
    --------
    >>> guard = Guard("127.0.0.1")
    >>> guard.knows_host("localhost:8765"), guard.knows_host("evil.example")
    (True, False)
    """

    address: str
    token: str = ""
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse an address without the token that it needs."""
        try:
            loopback = ipaddress.ip_address(self.address).is_loopback
        except ValueError:
            hint = "such as 127.0.0.1, 0.0.0.0, ::"
            raise InputError(f"address {self.address!r}", "is no IP address", hint) from None
        if not self.token and (not loopback or self.names):
            what = f"the live page on {self.names[0] if loopback else self.address}"
            hint = f"set {TOKEN_VARIABLE}, or name a file that holds one"
            raise InputError(what, "needs a token: others could read it", hint)

    def knows_host(self, host: str | None) -> bool:
        """Whether a request's Host is an address, localhost or one of our names."""
        name = _name_of(f"//{host}") if host else None
        if not name:
            return False
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name == "localhost" or name in {known.lower() for known in self.names}
        return True

    def knows_origin(self, origin: str | None, host: str | None) -> bool:
        """Whether a live connection comes from our own page; programs send no Origin."""
        if origin is None:
            return True
        return bool(host) and urlsplit(origin).netloc.lower() == str(host).lower()

    def is_token(self, given: str) -> bool:
        """Compare a token, in a time that tells nothing."""
        return bool(self.token) and hmac.compare_digest(_bytes(given), _bytes(self.token))

    @property
    def cookie(self) -> str:
        """What a browser that gave the token is given: says nothing of it, needs no memory."""
        return hmac.new(_bytes(self.token), b"deepseis live page", hashlib.sha256).hexdigest()

    def admits(self, authorization: str, cookie: str) -> bool:
        """Whether a request carries the token (``Bearer``) or the cookie, if one is needed."""
        if not self.token:
            return True
        scheme, _, given = authorization.partition(" ")
        if scheme.lower() == "bearer" and self.is_token(given.strip()):
            return True
        return hmac.compare_digest(_bytes(cookie), _bytes(self.cookie))


def _name_of(url: str) -> str | None:
    try:
        return urlsplit(url).hostname
    except ValueError:
        return None


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")
