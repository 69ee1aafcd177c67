"""Ambiguities in report.json: what a later plan needs to tell rivals apart, as plain types."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.errors import UnreadableInput
from imucalib.loop.separation.plan import Beside, Separation
from imucalib.loop.separation.products import Ambiguity, Products

#: Key of the block that every calibrator's report has.
KEY = "record_next"


def ambiguity_block(found: Ambiguity) -> dict[str, Any]:
    """One ambiguity as plain types; `ambiguity_of` reads it back."""
    products = found.products
    return {
        "effect": found.effect,
        "base": list(found.base),
        "columns": list(found.columns),
        "rivals": list(found.rivals),
        "blocks": {name: [int(at[0]), int(at[-1]) + 1] for name, at in found.blocks.items()},
        "evidence_nats": dict(found.nats),
        "noise_dof": found.dof,
        "gram": products.gram.tolist(),
        "along": products.along.tolist(),
        "power": products.power,
        "numbers": products.numbers,
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
    nats = {n: math.nan if v is None else float(v) for n, v in block["evidence_nats"].items()}
    gram = np.array(block["gram"], float).reshape(size, size)
    along = np.array(block["along"], float).reshape(size)
    products = Products(gram, along, float(block["power"]), float(block["numbers"]))
    return Ambiguity(
        effect=str(block["effect"]),
        base=tuple(str(name) for name in block["base"]),
        columns=columns,
        rivals=rivals,
        blocks=blocks,
        nats=nats,
        products=products,
        dof=float(block["noise_dof"]),
    )


def separation_block(found: Separation) -> dict[str, Any]:
    """A plan that a run has made itself, as plain types; `separation_of` reads it back."""
    return {
        "effect": found.effect,
        "rivals": list(found.rivals),
        "evidence_nats": dict(found.nats),
        "pairs": [list(pair) for pair in found.pairs],
        "plan": list(found.plan),
        "now": found.now.tolist(),
        "then": found.apart.tolist(),
        "ended": dict(found.ended),
        "never": [list(pair) for pair in found.never],
        "informative": found.informative and vars(found.informative),
        "random": found.random and vars(found.random),
    }


def separation_of(block: Mapping[str, Any]) -> Separation:
    """Read what `separation_block` wrote; KeyError, TypeError or ValueError where it is damaged."""

    def pairs(name: str) -> tuple[tuple[str, str], ...]:
        return tuple((str(truth), str(other)) for truth, other in block[name])

    def beside(name: str) -> Beside | None:
        one = block[name]
        if one is None:
            return None
        needed = None if one["needed"] is None else int(one["needed"])
        return Beside(float(one["apart"]), needed, int(one["followed"]))

    nats = {n: math.nan if v is None else float(v) for n, v in block["evidence_nats"].items()}
    return Separation(
        effect=str(block["effect"]),
        rivals=tuple(str(name) for name in block["rivals"]),
        nats=nats,
        pairs=pairs("pairs"),
        plan=tuple(int(k) for k in block["plan"]),
        now=np.array(block["now"], float),
        apart=np.array(block["then"], float),
        ended={str(name): float(v) for name, v in block["ended"].items()},
        never=pairs("never"),
        informative=beside("informative"),
        random=beside("random"),
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
