"""What a recording says of every effect, as a block of report.json: `imucal fleet` pools it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.data import fields
from imucalib.posterior.closed_loop.sums import BaseParameters, Sums

#: Key of the block.
KEY = "effects_beside_base"


def sums_block(sums: Sums) -> dict[str, Any]:
    """As plain types, products to seven digits; `sums_of` reads it back."""
    return {
        **fields(sums.base, "parameters theta covariance"),
        "blocks": {name: [int(at[0]), int(at[-1]) + 1] for name, at in sums.blocks.items()},
        "gram": [_round_numbers(row[: k + 1]) for k, row in enumerate(sums.gram)],
        "along": _round_numbers(sums.along),
        "taken": [_round_numbers(row) for row in sums.taken],
        **fields(sums, "noise_mg=noise noise_dof=dof wander_mg=drift"),
    }


def _round_numbers(values: Array) -> list[float]:
    return [float(f"{v:.7g}") for v in values]


def sums_of(block: Mapping[str, Any]) -> Sums:
    """Read what `sums_block` wrote; KeyError, TypeError or ValueError where it is damaged."""
    names = tuple(str(name) for name in block["parameters"])
    p, m = len(names), len(block["along"])
    lower = np.zeros((m, m))
    lower[np.tril_indices(m)] = np.concatenate([np.zeros(0), *block["gram"]])
    blocks = {str(n): np.arange(int(a), int(b)) for n, (a, b) in block["blocks"].items()}
    if not all(at.size and at[0] >= 0 and at[-1] < m for at in blocks.values()):
        raise ValueError("effects without columns")
    sums = Sums(
        base=BaseParameters(
            names,
            np.array(block["theta"], float).reshape(p),
            np.array(block["covariance"], float).reshape(p, p),
        ),
        blocks=blocks,
        gram=lower + np.tril(lower, -1).T,
        along=np.array(block["along"], float).reshape(m),
        taken=np.array(block["taken"], float).reshape(p, m),
        noise=float(block["noise_mg"]),
        dof=float(block["noise_dof"]),
        drift=float(block["wander_mg"]),
    )
    if not all(
        np.isfinite(v).all()
        for v in (sums.base.theta, sums.base.covariance, sums.gram, sums.along, sums.taken)
    ):
        raise ValueError("numbers that are none")
    return sums
