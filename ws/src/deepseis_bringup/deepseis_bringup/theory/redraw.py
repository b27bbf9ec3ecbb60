"""The theory of the loops, redrawn: figures as CSV, published numbers beside ours, one page."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from deepseis_bringup.theory import doppler as theory_doppler
from deepseis_bringup.theory import loop as theory_loop
from deepseis_bringup.theory import thesis as theory_thesis
from deepseis_bringup.theory.chart import Chart, Comparison, write_comparisons
from deepseis_bringup.theory.page import page

INCONSISTENCIES: Final = {
    "T 3.3, figure 3.10": (
        "With the printed Kg = 1e-9/g and Gg = 0.05 g²/Hz, vibration alone is 27° at 2 Hz and "
        "13.7° at 8 Hz: an aided loop would need 6.8 Hz, where the text says 2 Hz. A tenth of Kg, "
        "or an oscillator beside the table as in our scenarios, takes the contradiction away."
    ),
    "T 3.4": (
        "The exponent of the first (1.89 Bn) is lost; it is 3. The factor 2π² gives half the "
        "variance that a one-sided S_y has: 4π², as the error of a simulated oscillator shows."
    ),
    "T 3.7": (
        "As printed, the stress is added. Of twelve readings (damping 0.707 or 1, Kg 0, 1e-10 or "
        "1e-9/g, stress added or under the root) those near 18 Hz and 30 dB-Hz at once have it "
        "under the root: damping 1 without vibration or with 1e-10/g (18.1 Hz, 29.3 dB-Hz), and "
        "0.707 with 1e-9/g (17.4 Hz, 29.6 dB-Hz). The text does not tell which was drawn."
    ),
    "T 3.22": (
        "The square root of an angle is no angle. With it an aided loop needs 1.3 Hz for the "
        "printed 0.01 m/s and 2.3 Hz for 0.02 m/s, without it 0.8 and 0.9 Hz; the text has 2 Hz."
    ),
    "T table 3.1": (
        "Two headings, MTI-G and SPAN-FSAS, one column: that of the SPAN-FSAS. Its accelerometer "
        "biases (50 mGal constant, 1000 mGal in-run) are taken as swapped. The sensors of the "
        "MTI-G are from data sheets, a paper and, where nobody states a figure, our choice (see "
        "imu_grades); its navigation errors are our choice. In figures 3.8 and 3.9 a filter has "
        "estimated the turn-on biases: what is left is as large as the in-run part."
    ),
    "T table 2.1 at 20 ms": (
        "The analog constants make a loop of order 2 of “15 Hz” one of 51 Hz, of “8 Hz” one of "
        "13 Hz. Tables 5.3 and 5.4 come out with these; loops that really have 15 or 8 Hz lose "
        "lock in both scenarios."
    ),
    "D figure 6 and table 1": (
        "The text reads 24 and 32 dB-Hz off figure 6; table 1 uses 22.3 and 28.8, which D 1, 2, "
        "5 give at 15°. 24 and 32 would need some 10° of other noise, against 3° and 7° in all "
        "in figure 5."
    ),
    "D 4, D 6, figure 5": (
        "Oscillator and vibration are not stated. Of the 3° at 3 Hz, thermal noise is 1.9°; the "
        "thesis' OCXO, by D 4 at tau = 1 / Bn, would add 2.0°, together 2.8°."
    ),
    "D 1.3, table 2": (
        "10 g/s is called an acceleration, 25 g/s² a constant acceleration: both are jerks, g/s. "
        "2450 m/s are reached by 2 s up, 3 s at 50 g and 2 s down, not by the printed times."
    ),
    "D table 1": (
        "The C/N0 without jammer and the received power are not given: 41 dB-Hz and -170 dBW "
        "return every figure."
    ),
}
"""What the papers contradict themselves in, or do not say."""


def all_charts() -> dict[str, list[Chart]]:
    """Return the figures of each section of the page."""
    return {
        "Without aiding (thesis 3.3.1)": theory_thesis.conventional(),
        "What errors of the IMU leave (thesis 3.3.2, 3.3.3)": [
            *theory_thesis.imu_charts("mti-g"),
            *theory_thesis.imu_charts("span-fsas"),
        ],
        "With aiding (thesis 3.3.3)": [
            theory_thesis.aided("span-fsas"),
            theory_thesis.aided("mti-g"),
        ],
        "Order 3 at 1 ms (Doppler-aided paper, section 1)": theory_doppler.charts(),
        "The loop that is used: discrete, 20 ms": theory_loop.charts(),
    }


def all_comparisons() -> list[Comparison]:
    """Return published numbers beside ours."""
    return [
        *theory_thesis.comparisons(),
        *theory_doppler.comparisons(),
        *theory_loop.comparisons(),
    ]


def redraw(folder: Path) -> dict[str, Any]:
    """Write the CSV files, ``published.csv``, ``summary.json`` and ``report.html``.

    Returns
    -------
    dict
        As written to ``summary.json``.
    """
    sections, rows = all_charts(), all_comparisons()
    figures = [chart for charts in sections.values() for chart in charts]
    for chart in figures:
        chart.write_csv(folder)
    write_comparisons(rows, folder / "published.csv")
    summary: dict[str, Any] = {
        "figures": {chart.key: chart.title for chart in figures},
        "comparisons": [asdict(row) for row in rows],
        "inconsistencies": INCONSISTENCIES,
    }
    text = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
    html = page(sections, rows, INCONSISTENCIES, folder)
    (folder / "report.html").write_text(html, encoding="utf-8")
    return summary
