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

    Notes
    -----
    What was read may be quoted: line ends and control characters are written as escapes, and the
    middle of a long text is left out.

    Examples
    --------
    >>> str(InputError("a.bin", "is a directory", "name an IF file"))
    'a.bin: is a directory (name an IF file)'
    """

    def __init__(self, what: object, reason: str, hint: str = "") -> None:
        self.what, self.reason = _one_line(str(what)), _one_line(reason)
        self.hint = _one_line(hint, longest=3000)  # it may list all that is known
        super().__init__(f"{self.what}: {self.reason}" + (f" ({self.hint})" if hint else ""))


class DiskError(InputError):
    """What was computed could not be written: nothing was wrong with the input.

    A node that ends with it has failed (status 1), and what it wrote before is kept.
    """


def _one_line(text: str, longest: int = 400) -> str:
    r"""Make a text a part of one line that a terminal shows.

    Examples
    --------
    >>> _one_line("a\nb"), len(_one_line(1000 * "x"))
    ('a\\nb', 400)
    """
    if len(text) > longest:
        text = f"{text[: longest - 103]}...{text[-100:]}"
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
