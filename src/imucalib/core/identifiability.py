"""What the data cannot determine, in words.

A combination of parameters is open when the data know it worse than data sheets do: singular
values of the whitened Jacobian, scaled by each parameter's typical size.
"""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.core.parameter import Parameter

#: A combination counts as open when its standard deviation exceeds this many typical sizes.
OPEN_AT = 3.0


def null_directions(
    white_jacobian: Array, parameters: tuple[Parameter, ...], factor: float
) -> tuple[str, ...]:
    """Sentences for each open combination; white_jacobian is (N, p) at noise factor 1."""
    if not parameters:
        return ()
    typical = np.array([p.typical for p in parameters])
    scaled = white_jacobian * typical / factor
    if len(scaled) > len(parameters):
        scaled = np.linalg.qr(scaled, mode="r")
    _, values, rows = np.linalg.svd(scaled, full_matrices=True)
    values = np.concatenate([values, np.zeros(len(parameters) - values.size)])
    found = [rows[k] for k in range(len(parameters)) if values[k] * OPEN_AT < 1.0]
    return tuple(_words(direction, parameters) for direction in found)


def _words(direction: Array, parameters: tuple[Parameter, ...]) -> str:
    order = np.argsort(-np.abs(direction))
    share = np.abs(direction) / np.abs(direction).max()
    main = [parameters[k].name for k in order if share[k] > 0.2][:5]
    if len(main) == 1:
        return f"{main[0]} is not determined"
    return f"{main[0]} cannot be told from {', '.join(main[1:])}"
