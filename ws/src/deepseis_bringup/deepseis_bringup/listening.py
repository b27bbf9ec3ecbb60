"""A port of this machine for others to connect to."""

from __future__ import annotations

import socket

from deepseis_core.errors import InputError


def listening(address: str, port: int, what: str, hint: str = "") -> socket.socket:
    """Return a socket that listens.

    Parameters
    ----------
    address : str
        Of this machine.
    port : int
        0: any that is free.
    what, hint : str
        Whose port it is and what to do about it, for the error.

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
        raise InputError(f"{what} on {address} port {port}", reason, hint) from None
