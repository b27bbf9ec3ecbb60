"""The port of the live page."""

from __future__ import annotations

import socket

from deepseis_core.errors import InputError


def listening(address: str, port: int) -> socket.socket:
    """Return a socket that listens.

    Raises
    ------
    InputError
        The port is taken, or the address is not this machine's.
    """
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    try:
        return socket.create_server((address, port), family=family, backlog=64)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        hint = "choose another with --web PORT"
        raise InputError(f"live page on {address} port {port}", reason, hint) from None
