"""Ambiguities in report.json: what a later plan needs to tell rivals apart, as plain types."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.calibration.plain import fields
from imucalib.errors import UnreadableInput
from imucalib.posterior.closed_loop.separation import Ambiguity

#: Key of the block that every calibrator's report has.
KEY = "record_next"


def ambiguity_block(found: Ambiguity) -> dict[str, Any]:
    """One ambiguity as plain types; `ambiguity_of` reads it back."""
    return {
        **fields(found, "effect base columns rivals"),
        "blocks": {name: [int(at[0]), int(at[-1]) + 1] for name, at in found.blocks.items()},
        **fields(found, "gram along power numbers"),
    }


def ambiguity_of(block: Mapping[str, Any]) -> Ambiguity:
    """Read what `ambiguity_block` wrote; KeyError, TypeError or ValueError where it is damaged."""
    columns = tuple(str(name) for name in block["columns"])
    size = len(columns)
    blocks = {str(n): np.arange(int(a), int(b)) for n, (a, b) in block["blocks"].items()}
    rivals = tuple(str(name) for name in block["rivals"])
    inside = all(0 <= int(at[0]) <= int(at[-1]) < size for at in blocks.values())
    if len(rivals) < 2 or not inside or not set(rivals) <= set(blocks):
        raise ValueError("rivals without columns")
    gram = np.array(block["gram"], float).reshape(size, size)
    along = np.array(block["along"], float).reshape(size)
    return Ambiguity(
        effect=str(block["effect"]),
        base=tuple(str(name) for name in block["base"]),
        columns=columns,
        rivals=rivals,
        blocks=blocks,
        gram=gram,
        along=along,
        power=float(block["power"]),
        numbers=float(block["numbers"]),
    )


def read_report(folder: Path) -> dict[str, Any]:
    """report.json of a run's folder. Raises UnreadableInput where there is none that serves."""
    path = folder / "report.json"
    if not path.is_file():
        raise UnreadableInput(
            "no report.json beside the calibration",
            where=str(folder),
            remedy="give the folder that a calibrating command wrote, with all of its files",
        )
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        calibrator = content["calibrator"]
    except (ValueError, KeyError, TypeError):
        raise UnreadableInput("no report of imucal", where=str(path)) from None
    if KEY not in content:
        raise UnreadableInput(
            "the report does not hold what a plan needs",
            where=str(path),
            remedy=f"calibrate again with this version: imucal {calibrator}, with its search",
        )
    return dict(content)
