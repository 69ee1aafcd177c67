"""What an array's model could lack: catalogue effects, one bad IMU, and smooth curves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.array_effect import ArrayEffect, ArrayMotion
from imucalib.array_effects import array_catalogue
from imucalib.calibrators.array_state import ArrayState
from imucalib.calibrators.array_terms import columns_of
from imucalib.estimators.array_gram import Columns
from imucalib.estimators.array_samples import turning
from imucalib.evidence import Kind
from imucalib.units import DEG

Array = NDArray[np.float64]
Index = NDArray[np.intp]
#: Typical size of an unknown curve, and how many terms it has.
_CURVE = {"accelerometer": 0.1, "gyroscope": 0.3 * DEG}
_TERMS = 4
#: The same of an IMU that moves on the board (m) or whose clock does (s), and terms of these.
_MOVE, _LATE, _SLOW = 5e-5, 5e-5, 2


@dataclass(frozen=True)
class Entry:
    """One candidate. block : of the columns; part : which of its columns (typical sizes scaled);
    only : the IMU of a scan"""

    name: str
    kind: Kind
    driver: str
    block: int
    part: Index
    effect: ArrayEffect | None = None
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
        reason = effect.missing(motion)
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
            entries.append(Entry(effect.name, "effect", effect.sensor, here, every, effect))
        for k, imu in enumerate(motion.imus if effect.scan else ()):
            name = f"{effect.name}@{imu}"
            if name not in taken | rejected:
                part = np.arange(k * m, (k + 1) * m)
                entries.append(Entry(name, "effect", imu, here, part, effect, k))
    for name, driver, columns in _curves(motion):
        blocks.append(columns)
        every = np.arange(columns.size)
        entries.append(Entry(name, "probe", driver, len(blocks) - 1, every))
    for words, columns in _wanderings(motion):
        blocks.append(columns)
        each = columns.basis.shape[3]
        for k, imu in enumerate(motion.imus):
            part = np.arange(k * each, (k + 1) * each)
            name = f"{words} of {imu} against time"
            entries.append(Entry(name, "probe", imu, len(blocks) - 1, part))
    return Candidates(tuple(blocks), tuple(entries), missing)


def _curves(motion: ArrayMotion) -> list[tuple[str, str, Columns]]:
    """Smooth curves of each axis' error: alike in all packages against the size of rate and
    force and against what the axis itself reads, of each IMU by itself against time."""
    force = np.linalg.norm(motion.force, axis=2)
    speed = np.broadcast_to(np.linalg.norm(motion.rate, axis=1)[:, None], force.shape)
    time = np.broadcast_to(motion.order[:, None], force.shape)
    found = []
    for gyro, sensor in ((False, "accelerometer"), (True, "gyroscope")):
        for driver, values, shared in (
            ("|ω|", speed, True),
            ("|a|", force, True),
            ("time", time, False),
        ):
            curves = _cosines(values, _TERMS) * _CURVE[sensor]
            basis = np.einsum("tkc,ij->tkijc", curves, np.eye(3))
            basis = motion.turned(basis.reshape(*force.shape, 3, -1))
            columns = Columns(basis, gyro, shared)
            found.append((f"{sensor} error against {driver}", driver, columns))
        own = motion.seen(motion.rate if gyro else motion.force)
        curves = _cosines(own, _TERMS) * _CURVE[sensor]
        basis = np.einsum("tkic,ij->tkijc", curves, np.eye(3)).reshape(*own.shape, -1)
        driver = "ω" if gyro else "a"
        name = f"{sensor} error against its own {driver}"
        found.append((name, driver, Columns(motion.turned(basis), gyro, True)))
    return found


def _wanderings(motion: ArrayMotion) -> list[tuple[str, Columns]]:
    """What each IMU by itself reads more when it moves on the board, or its clock against the
    others', along smooth curves of time."""
    curves = _cosines(motion.order, _SLOW)
    move = _MOVE * turning(motion.rate, motion.spin)
    late = -_LATE * motion.spin[:, :, None]
    found = []
    for words, gyro, each in (("position", False, move), ("gyro delay", True, late)):
        whole = np.einsum("tij,tc->tijc", each, curves).reshape(len(motion.t), 1, 3, -1)
        columns = Columns(np.repeat(whole, len(motion.imus), axis=1), gyro, False)
        found.append((words, columns))
    return found


def _cosines(values: Array, terms: int) -> Array:
    low, high = float(values.min()), float(values.max())
    unit = (values - low) / max(high - low, 1e-300)
    k = np.arange(1, terms + 1)
    return np.asarray(np.sqrt(2.0) * np.cos(np.pi * k * unit[..., None]) / k)
