"""The commissioning of a station: checks of its first minutes, a page, a verdict."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

from deepseis_bringup.commission.checks import FAIL, OPEN, PASS, Check
from deepseis_bringup.commission.data import StationData, read_station_data
from deepseis_bringup.commission.imu_checks import gravity, noise, turning
from deepseis_bringup.commission.motion_checks import shaking
from deepseis_bringup.commission.receiver_checks import (
    clock,
    phase_centre,
    position,
    signal,
    start_time,
)
from deepseis_bringup.report.document import document, page_head

LONGEST_S: Final = 600.0
CELL: Final = "white-space:normal;text-align:left"
COLOURS: Final = {PASS: "#1a7f37", FAIL: "#cf222e", OPEN: "#8a6100"}


def commission(bag: Path, folder: Path, *, longest_s: float = LONGEST_S) -> dict[str, Any]:
    """Check a station and write ``commission.html`` and ``commission.json``.

    Parameters
    ----------
    bag : Path
        Of the station's run.
    folder : Path
        Gets the page; exists.
    longest_s : float
        So much of the bag is looked at [s].

    Returns
    -------
    dict
        ``passed``, ``failed``, ``open``: how many; ``checks``: each.

    Raises
    ------
    InputError
        The bag cannot be used.
    """
    data = read_station_data(bag, longest_s)
    checks = all_checks(data)
    count = {status: sum(c.status == status for c in checks) for status in (PASS, FAIL, OPEN)}
    result = {
        "station": data.station.name,
        "passed": count[PASS],
        "failed": count[FAIL],
        "open": count[OPEN],
        "verdict": verdict(checks),
        "checks": [vars(check) for check in checks],
    }
    (folder / "commission.html").write_text(page(data.station.name, checks), encoding="utf-8")
    text = json.dumps(result, indent=2, ensure_ascii=False) + "\n"
    (folder / "commission.json").write_text(text, encoding="utf-8")
    return result


def all_checks(data: StationData) -> list[Check]:
    """Return all checks of a station, in the order in which a person would mend things."""
    receiver = (start_time, position, phase_centre, clock, signal)
    imu = (gravity, turning, noise, shaking)
    return [found for check in (*receiver, *imu) for found in check(data)]


def verdict(checks: Sequence[Check]) -> str:
    """Say in a sentence how it stands.

    Examples
    --------
    >>> verdict([Check("a", PASS, "", ""), Check("b", OPEN, "", "")])
    'Passed as far as the data tell; 1 check is open.'
    >>> verdict([Check("a", PASS, "", ""), Check("lever arm", FAIL, "", "")])
    'Not fit for service: 1 of 2 checks fails: lever arm.'
    """
    failed = [c for c in checks if c.status == FAIL]
    left = [c for c in checks if c.status == OPEN]
    if failed:
        fail, names = "fails" if len(failed) == 1 else "fail", "; ".join(c.name for c in failed)
        return f"Not fit for service: {len(failed)} of {len(checks)} checks {fail}: {names}."
    if left:
        are = "check is" if len(left) == 1 else "checks are"
        return f"Passed as far as the data tell; {len(left)} {are} open."
    return "Passed."


def page(station: str, checks: Sequence[Check]) -> str:
    """Return the page: what failed first."""
    order = {FAIL: 0, OPEN: 1, PASS: 2}
    rows = "".join(_row(check) for check in sorted(checks, key=lambda c: order[c.status]))
    title = f"Commissioning of {station or 'the station'}"
    head = page_head("commissioning", title, verdict(checks))
    names = ("Check", "Result", "Found", "Expected", "What to look at")
    headings = "".join(f'<th style="{CELL}">{name}</th>' for name in names)
    table = (
        f"<h2>Checks</h2><figure><div class='scroll'><table><thead><tr>{headings}</tr></thead>"
        f"<tbody>{rows}</tbody></table></div></figure>"
    )
    return document(title, head, [table], [], "What each check means: docs/operations.md.")


def _row(check: Check) -> str:
    colour = COLOURS[check.status]
    mark = f'<strong style="color:{colour}">{check.status}</strong>'
    cells = (escape(check.name), mark, *map(escape, (check.found, check.expected, check.text)))
    return "<tr>" + "".join(f'<td style="{CELL}">{c}</td>' for c in cells) + "</tr>"
