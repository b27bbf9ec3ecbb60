"""Rotation matrices on arrays of vectors, elementwise.

Nothing here goes through BLAS: that rounds by the shape of what it is given, and the truth would
depend on how a recording is cut into chunks.
"""

from __future__ import annotations

import numpy as np

from deepseis_core.types import FloatArray


def turn(C: FloatArray, vector: FloatArray) -> FloatArray:
    """Apply rotation matrices, shape (3, 3) or (m, 3, 3), to vectors, (3,) or (m, 3)."""
    x, y, z = vector[..., :1], vector[..., 1:2], vector[..., 2:]
    return C[..., 0] * x + C[..., 1] * y + C[..., 2] * z


def turn_back(C: FloatArray, vector: FloatArray) -> FloatArray:
    """Apply the inverse of rotation matrices; shapes as in `turn`."""
    return turn(np.swapaxes(C, -1, -2), vector)


def compose(later: FloatArray, earlier: FloatArray) -> FloatArray:
    """Multiply rotation matrices, each of shape (3, 3) or (m, 3, 3)."""
    columns = [turn(later, earlier[..., k]) for k in range(3)]
    return np.stack(columns, axis=-1)
