"""How well size, frame and shape of an array are known, and by what."""

from __future__ import annotations

import numpy as np

from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.estimate.total import GyroScale, Total, size_over
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.report.document import Facts
from imucalib.significant_digits import plus_minus
from imucalib.units import DEG


def known_facts(total: Total, gyros: GyroScale, board: Board, request: ArrayRequest) -> Facts:
    """Size, what fixes it, frame and shape: how far each is known."""
    value, sd, motion = size_over(board.drawn, total)
    shape = 1e3 * float(np.sqrt(np.median(np.diag(total.shape))))
    turns = gyros.turns
    scale = f"{plus_minus(100 * gyros.value, 100 * gyros.sd)} %"
    if turns is None:
        scale += ", by the data sheets alone: turn the board by 90 deg or more between rests"
    else:
        scale += (
            f": {turns.count} turns between rests ({plus_minus(100 * turns.scale, 100 * turns.sd)} "
            f"%, misfit {turns.misfit / DEG:.2g} deg) and the data sheets' ± "
            f"{100 * gyros.tolerance:.2g} %"
        )
    rows = [
        ("size over drawing", f"{plus_minus(value, sd)}, of which the motion ± {motion:.2g}"),
        ("gyros' common scale", scale),
        ("gravity", f"± {100 * total.gravity_sd:.2g} % of the size ({request.gravity_source})"),
    ]
    for d in request.distances:
        after, after_sd = (1e3 * v for v in total.distance(d.one, d.two))
        words = f"{plus_minus(1e3 * d.value, 1e3 * d.sd)} mm as measured, "
        words += f"{plus_minus(after, after_sd)} mm after all"
        rows.append((f"{board.imus[d.one]} to {board.imus[d.two]}", words))
    rows += [
        ("frame", f"± {np.sqrt(np.mean(total.frame_sd**2)) / DEG:.2g} deg about each axis: the "
         "triads' mean axes against the board's"),
        ("shape", f"± {shape:.2g} mm (median), whatever size and frame are"),
    ]  # fmt: skip
    return Facts(tuple(rows))
