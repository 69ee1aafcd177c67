"""Directions on the sphere."""

import numpy as np

from imucalib.arrays import Array


def even_directions(n: int = 400) -> Array:
    """(n, 3) unit vectors spread evenly (a Fibonacci spiral)."""
    k = np.arange(n) + 0.5
    z = 1.0 - 2.0 * k / n
    angle = np.pi * (1.0 + np.sqrt(5.0)) * k
    r = np.sqrt(1.0 - z**2)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1)
