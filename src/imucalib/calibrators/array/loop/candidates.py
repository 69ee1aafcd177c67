"""What an array's model could lack: catalogue effects, one bad IMU, and smooth curves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Index
from imucalib.calibrators.array.loop.catalogue import array_catalogue
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


def candidates(state: ArrayState, rejected: frozenset[str]) -> Candidates:
    """Everything that could be missing beside what is in the model or was rejected."""
    motion, taken = state.motion, {term.name for term in state.terms}
    blocks: list[Columns] = []
    entries: list[Entry] = []
    missing: dict[str, str] = {}
    for effect in array_catalogue().values():
        reason = effect.missing(motion.context)
        if reason:
            missing[effect.name] = reason
            continue
        if effect.name in taken:
            continue
        columns = columns_of(effect, motion)
        m = columns.basis.shape[3]
        typical = np.array([p.typical for p in effect.each])
        blocks.append(Columns(columns.basis * typical, columns.gyro, columns.shared))
        here = len(blocks) - 1
        if effect.name not in rejected:
            every = np.arange(columns.size)
            entries.append(
                Entry(effect.name, "effect", SENSOR[effect.channel], here, every, effect)
            )
        for k, imu in enumerate(motion.context.triads if effect.scan else ()):
            name = f"{effect.name}@{imu}"
            if name not in taken | rejected:
                part = np.arange(k * m, (k + 1) * m)
                entries.append(
                    Entry(
                        name=name,
                        kind="effect",
                        driver=imu,
                        block=here,
                        part=part,
                        effect=effect,
                        only=k,
                    )
                )
    _add_curves(blocks, entries, motion, taken)
    return Candidates(tuple(blocks), tuple(entries), missing)


def _add_curves(
    blocks: list[Columns], entries: list[Entry], motion: BoardMotion, taken: set[str]
) -> None:
    for driver, curve in array_curves(motion):
        if CURVE + curve.name in taken:
            continue
        columns = columns_of(curve, motion)
        typical = np.array([p.typical for p in curve.each])
        blocks.append(Columns(columns.basis * typical, columns.gyro, columns.shared))
        here, each = len(blocks) - 1, len(typical)
        if driver:
            entries.append(Entry(curve.name, "probe", driver, here, np.arange(columns.size), curve))
            continue
        for k, imu in enumerate(motion.context.triads):
            name = curve.name.format(imu=imu)
            if CURVE + name not in taken:
                part = np.arange(k * each, (k + 1) * each)
                entries.append(
                    Entry(
                        name=name,
                        kind="probe",
                        driver=imu,
                        block=here,
                        part=part,
                        effect=curve,
                        only=k,
                    )
                )
