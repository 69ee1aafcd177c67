"""Directions on the sphere."""

import numpy as np

from imucalib.arrays import Array, Index

#: Cells of the sphere in which postures are counted.
CELLS = 96


def counted(directions: Array) -> Index:
    """(CELLS,) how many of the vectors (n, 3) point into each cell of the sphere."""
    return np.bincount(cell_of(directions), minlength=CELLS)


def cell_of(directions: Array) -> Index:
    """(n,) the cell that each vector (n, 3) points into: the nearest of CELLS even directions."""
    return np.asarray(np.argmax(directions @ even_directions(CELLS).T, axis=1), np.intp)


def covered(directions: Array, within: float = 30.0) -> float:
    """Share of the sphere within so many deg of one of the vectors (n, 3)."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    nearest = (even_directions() @ unit.T).max(axis=1)
    return float(np.mean(nearest >= np.cos(np.radians(within))))


def even_directions(n: int = 400) -> Array:
    """(n, 3) unit vectors spread evenly (a Fibonacci spiral)."""
    k = np.arange(n) + 0.5
    z = 1.0 - 2.0 * k / n
    angle = np.pi * (1.0 + np.sqrt(5.0)) * k
    r = np.sqrt(1.0 - z**2)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1)
