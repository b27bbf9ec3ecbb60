import csv
import json
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from deepseis_bringup.cli import app

FIGURES = {
    *("thesis-3-5", "thesis-3-6", "thesis-3-8a", "thesis-3-8b", "thesis-3-9a", "thesis-3-9b"),
    *("thesis-3-10a", "thesis-3-10b", "doppler-2", "doppler-4", "doppler-5", "doppler-6"),
    *("loop-sine-1hz", "loop-sine-2hz", "loop-motion", "loop-limit"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("theory") / "out"
    run = CliRunner().invoke(app, ["theory", "-o", str(path)])
    assert run.exit_code == 0, run.output
    assert run.output.strip().splitlines()[-1] == str(path)
    return path


@pytest.fixture(scope="module")
def summary(folder: Path) -> Any:
    return json.loads((folder / "summary.json").read_text("utf-8"))


def table(folder: Path, key: str) -> dict[str, Any]:
    with (folder / f"{key}.csv").open(encoding="utf-8") as stream:
        head, *rows = csv.reader(stream)
    return dict(zip(head, np.array(rows, np.float64).T, strict=True))


def test_every_figure_is_there_and_on_the_page(folder: Path, summary: Any) -> None:
    assert set(summary["figures"]) == FIGURES
    html = (folder / "report.html").read_text("utf-8")
    assert html.count("data-panel=") == len(FIGURES)
    for title in summary["figures"].values():
        assert escape(title) in html
    for key in FIGURES:
        columns = table(folder, key)
        assert len(columns) >= 3
        x = next(iter(columns.values()))
        assert np.all(np.diff(x) > 0)


def test_pages_need_nothing_from_outside(folder: Path) -> None:
    html = (folder / "report.html").read_text("utf-8")
    assert 'src="http' not in html
    assert "<link" not in html


def test_published_numbers_stand_beside_ours(folder: Path, summary: Any) -> None:
    with (folder / "published.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert rows == summary["comparisons"]
    found = {(row["quantity"], row["published"]): row["ours"] for row in rows}
    assert found["aided, 3 Hz: J/S and range of 100 W", "37.74 dB; 621.61 km"].startswith("37.74")
    assert found["best bandwidth without aiding", "25 Hz, 7°"].startswith("31 Hz, 7.1°")
    assert "24 and 32" in summary["inconsistencies"]["D figure 6 and table 1"]
    assert any("table 3.1" in key for key in summary["inconsistencies"])


def test_figure_3_5_falls_below_15_degrees_at_the_text_s_bandwidth(folder: Path) -> None:
    columns = table(folder, "thesis-3-5")
    total = columns["the same, stress under the root"]
    crossing = np.interp(-15.0, -total, columns["noise bandwidth [Hz]"])
    assert crossing == pytest.approx(18.0, abs=0.5)  # the text's digit


def test_a_full_folder_is_refused(folder: Path) -> None:
    again = CliRunner().invoke(app, ["theory", "-o", str(folder)])
    assert again.exit_code == 2
    assert "not empty" in again.output
