"""Rows of known directions, without dials, whose reading belongs to another direction.

The linear map (12 parameters) of the three quarters of rows that fit it best, found by
concentration steps (Rousseeuw and Van Driessen 1999), says where each reading belongs.
"""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.estimators.starting_point import concentrated
from imucalib.loop.faults.found import ENOUGH, Fault

#: Share of the rows that make the map.
_SHARE = 0.75
#: Misfit (mg) that any fixture may have: bias, tilt and noise.
_FIXTURE = 20.0
_FACES = {tuple(s * np.eye(3)[a]): f"{'-+'[s > 0]}{'xyz'[a]}" for a in range(3) for s in (1, -1)}


def wrong_directions(reading: Array, direction: Array, row: Index) -> tuple[Fault, ...]:
    """Rows exchanged with each other, and rows whose direction is another one of the table.

    reading : (n, 3) mg; direction : (n, 3) unit vectors; row : (n,) numbers of the table's rows
    """
    every = np.unique(direction, axis=0)
    made = _map(reading, direction)
    if made is None:
        return ()
    own = np.linalg.norm(reading - _read(direction, made), axis=1)
    each = np.linalg.norm(reading[:, None] - _read(every, made)[None], axis=2)
    fits = np.argmin(each, axis=1)
    worth = 3.0 * np.log(np.maximum(own, _FIXTURE) / np.maximum(each.min(axis=1), _FIXTURE))
    wrong = np.flatnonzero(worth > ENOUGH)
    found, told = [], set[int]()
    for k in wrong:
        other = [m for m in wrong if _same(every[fits[m]], direction[k])]
        twin = next((m for m in other if m > k and _same(every[fits[k]], direction[m])), None)
        if k in told:
            continue
        if twin is not None and twin not in told:
            told.add(int(twin))
            found.append(_exchanged(int(row[k]), int(row[twin]), float(worth[k] + worth[twin])))
        elif not _same(every[fits[k]], -direction[k]):  # a lost sign as well, which others tell
            found.append(_noted(int(row[k]), direction[k], every[fits[k]], float(worth[k])))
    return tuple(found)


def _map(reading: Array, direction: Array) -> Array | None:
    """(4, 3) mg, the linear map of the rows that fit it best; None where it stays open."""
    design = np.column_stack([direction, np.ones(len(direction))])
    every = np.arange(len(design))
    return concentrated(design, reading, every, max(5, int(_SHARE * len(design)))).map


def _read(direction: Array, made: Array) -> Array:
    return np.asarray(direction @ made[:3] + made[3])


def _same(one: Array, other: Array) -> bool:
    return bool(np.allclose(one, other, atol=1e-9))


def _exchanged(row: int, other: int, score: float) -> Fault:
    what = f"rows {row} and {other}: their readings are exchanged"
    return Fault("exchange", what, (row, other), score, f"--swap {row},{other}")


def _noted(row: int, said: Array, fits: Array, score: float) -> Fault:
    what = f"row {row}: the sheet says {_named(said)} where the reading fits {_named(fits)}"
    face = _FACES.get(tuple(fits))
    line = (
        f"--fix {row}:face={face}"
        if face
        else " ".join(
            f"--fix {row}:{axis}={value:.10g}"
            for axis, value in zip(("ux", "uy", "uz"), fits, strict=True)
        )
    )
    return Fault("angle", what, (row,), score, line)


def _named(direction: Array) -> str:
    face = _FACES.get(tuple(direction))
    return f"face {face}" if face else ", ".join(f"{v:+.3f}" for v in direction)
