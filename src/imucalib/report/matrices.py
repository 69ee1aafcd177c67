"""The linear part of a calibration as report blocks, for every calibrator that has one."""

from __future__ import annotations

from imucalib.calibration.matrices import Matrices
from imucalib.report.document import Facts, Table
from imucalib.significant_digits import plus_minus, with_sd
from imucalib.units import MG


def linear_blocks(linear: Matrices, note: str) -> tuple[Table, Facts]:
    """M, b and the scales as a table with a note, and the angles between the sensing axes."""
    rows = tuple(
        (
            letter,
            "  ".join(f"{v:+.6f}" for v in linear.M[k]),
            f"{linear.b[k] / MG:+.3f}",
            *with_sd(float(linear.scale[k]), float(linear.scale_sd[k])),
        )
        for k, letter in enumerate("xyz")
    )
    header = ("axis", "M", "b, mg", "scale", "sd")
    table = Table("corrected = M raw + b", header, rows, "llrrr", note)
    angles = Facts(
        tuple(
            (f"angle {pair}", plus_minus(float(a), float(s), "deg"))
            for pair, a, s in zip(("xy", "xz", "yz"), linear.angle, linear.angle_sd, strict=True)
        )
    )
    return table, angles
