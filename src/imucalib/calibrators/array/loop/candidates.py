"""What an array's model could lack: catalogue effects, one bad IMU, and smooth curves."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Index
from imucalib.calibrators.array.loop.catalogue import array_catalogue, twins_of
from imucalib.calibrators.array.loop.curves import CURVE, SENSOR, array_curves
from imucalib.calibrators.array.loop.motion import BoardMotion
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.loop.terms import columns_of
from imucalib.core.effect import Response
from imucalib.estimators.array.gram import Columns
from imucalib.loop.evidence import Kind


@dataclass(frozen=True)
class Entry:
    """One candidate. block : of the columns; part : which of its columns (typical sizes scaled);
    only : the IMU of a scan"""

    name: str
    kind: Kind
    driver: str
    block: int
    part: Index
    effect: Response | None = None
    only: int | None = None


@dataclass(frozen=True)
class Candidates:
    """blocks of columns in units of typical sizes, entries that use them, and what cannot be
    tested, with the reason"""

    blocks: tuple[Columns, ...]
    entries: tuple[Entry, ...]
    missing: dict[str, str]


def candidates(state: ArrayState, rejected: frozenset[str], rows: Index) -> Candidates:
    """Everything that could be missing beside what is in the model or was rejected, with columns
    at some of the samples."""
    motion, taken = state.motion.take(rows), {term.name for term in state.terms}
    taken |= {twin for term in state.found for twin in twins_of(term.name)}
    blocks: list[Columns] = []
    entries: list[Entry] = []
    missing: dict[str, str] = {}
    for effect in array_catalogue().values():
        if effect.twin and effect.twin not in rejected:
            continue
        reason = effect.missing(motion.context)
        if reason:
            missing[effect.name] = reason
            continue
        if effect.name in taken:
            continue
        columns = typical_columns(effect, motion)
        blocks.append(columns)
        here = len(blocks) - 1
        if effect.name not in rejected:
            every = np.arange(columns.size)
            entries.append(
                Entry(effect.name, "effect", SENSOR[effect.channel], here, every, effect)
            )
        if effect.scan:
            own = _of_each("effect", effect, f"{effect.name}@{{imu}}", motion, here)
            entries += [e for e in own if e.name not in taken | rejected]
    _add_curves(blocks, entries, motion, taken, array_curves(state.motion))
    return Candidates(tuple(blocks), tuple(entries), missing)


def typical_columns(effect: Response, motion: BoardMotion, only: int | None = None) -> Columns:
    """Its columns in units of typical sizes, of all IMUs or of one."""
    columns = columns_of(effect, motion, only)
    columns.basis[...] *= np.array([p.typical for p in effect.each])
    return columns


def _of_each(
    kind: Kind, effect: Response, name: str, motion: BoardMotion, block: int
) -> list[Entry]:
    """One entry an IMU, of its own columns alone; `name` has the IMU's place in it."""
    size = len(effect.each)
    return [
        Entry(
            name=name.replace("{imu}", imu),
            kind=kind,
            driver=imu,
            block=block,
            part=np.arange(k * size, (k + 1) * size),
            effect=effect,
            only=k,
        )
        for k, imu in enumerate(motion.context.triads)
    ]


def _add_curves(
    blocks: list[Columns], entries: list[Entry], motion: BoardMotion, taken: set[str],
    curves: Iterable[tuple[str, Response]],
) -> None:  # fmt: skip
    for driver, curve in curves:
        if CURVE + curve.name in taken:
            continue
        columns = typical_columns(curve, motion)
        blocks.append(columns)
        here = len(blocks) - 1
        if driver:
            entries.append(Entry(curve.name, "probe", driver, here, np.arange(columns.size), curve))
            continue
        own = _of_each("probe", curve, curve.name, motion, here)
        entries += [e for e in own if CURVE + e.name not in taken]
