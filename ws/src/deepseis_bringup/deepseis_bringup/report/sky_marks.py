"""What sky plots have in common: axes, and names of satellites that do not hide each other."""

from __future__ import annotations

from typing import Any

import numpy as np

from deepseis_core.types import FloatArray


def polar_axes(elevation: FloatArray, azimuth: FloatArray) -> dict[str, Any]:
    """Return axes, the scale written where satellites leave room for it.

    Parameters
    ----------
    elevation, azimuth : ndarray, shape (n,)
        Of the satellites [deg].
    """
    low = azimuth[elevation < 75.0]
    free = np.array([30.0, 45.0, 60.0, 120.0, 135.0, 150.0, 210.0, 225.0, 240.0, 300.0, 330.0])
    gaps = np.abs((low[None, :] - free[:, None] + 180.0) % 360.0 - 180.0).min(axis=1, initial=180)
    angle = 90.0 - float(free[np.argmax(gaps)])
    return {
        "angularaxis": {
            **{"direction": "clockwise", "rotation": 90, "tickvals": [0, 90, 180, 270]},
            "ticktext": ["N", "E", "S", "W"],
        },
        "radialaxis": {
            **{"range": [0, 90], "tickvals": [0, 30, 60, 90], "angle": angle},
            **{"tickangle": angle, "ticktext": ["", "60°", "30°", ""]},
        },
    }


def label_places(elevation: FloatArray, azimuth: FloatArray) -> list[str]:
    """Put names above the marks, or below where another satellite stands close above.

    Parameters
    ----------
    elevation, azimuth : ndarray, shape (n,)
        Of the satellites [deg].

    Examples
    --------
    >>> label_places(np.array([40.0, 40.6, 10.0]), np.array([289.0, 277.0, 90.0]))
    ['top center', 'bottom center', 'top center']
    """
    r, theta = 90.0 - elevation, np.deg2rad(azimuth)
    x, y = r * np.sin(theta), r * np.cos(theta)
    aside, above = np.abs(x[None, :] - x[:, None]), y[None, :] - y[:, None]
    np.fill_diagonal(aside, np.inf)
    crowded = np.any((aside < 16.0) & (above >= 0.0) & (above < 24.0), axis=1)
    return ["bottom center" if c else "top center" for c in crowded.tolist()]
