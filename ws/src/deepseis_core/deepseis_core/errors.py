"""One clear line for whatever is wrong with what came in."""

from __future__ import annotations


class InputError(Exception):
    """Bad input: what and where, why, and what to do about it.

    Parameters
    ----------
    what : str or path
        The file, parameter or topic that is wrong.
    reason : str
        Why it cannot be used.
    hint : str, optional
        What the user can do.

    Examples
    --------
    >>> str(InputError("a.bin", "is a directory", "name an IF file"))
    'a.bin: is a directory (name an IF file)'
    """

    def __init__(self, what: object, reason: str, hint: str = "") -> None:
        self.what, self.reason, self.hint = str(what), reason, hint
        super().__init__(f"{what}: {reason}" + (f" ({hint})" if hint else ""))
