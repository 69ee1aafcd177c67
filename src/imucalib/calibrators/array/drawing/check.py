"""The board file against the log, before anything is fitted; what differs ends with its lines.

Accelerometers share gravity at rest, gyros the rate of one rigid board; gravity turns as the gyros
say; and the accelerometers' differences show who stands where.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.drawing.axes import (
    SIGNED,
    common_gyro_axes,
    in_words,
    relative_axes,
)
from imucalib.calibrators.array.drawing.places import Places, in_its_unit, places
from imucalib.calibrators.array.log import ArrayLog
from imucalib.calibrators.array.moving import SLOWEST
from imucalib.errors import Undetermined
from imucalib.rests.segments import Segments

_FEW = 3  # rests that show a frame
_SAMPLES = 4000  # moving samples that are looked at
_SHOWN = 8  # lines of a message


@dataclass(frozen=True)
class Drawn:
    """What the log says of a board file.

    accelerometer, gyro : (K, 3, 3) signed permutations of each package's axes, the identity where
    the drawing is right; places : or None where the motion does not show them
    """

    board: Board
    accelerometer: Array
    gyro: Array
    places: Places | None

    @property
    def faults(self) -> tuple[str, ...]:
        """What contradicts the board file, in words; empty where it fits."""
        wrong: dict[str, list[str]] = {"accelerometer": [], "gyro": []}
        found = []
        for k, name in enumerate(self.board.imus):
            mounting = self._mounting(k)
            if not self._moved(k) and not np.array_equal(mounting, np.eye(3)):
                found.append(f"{name} is mounted otherwise")
            for sensor, own in (("accelerometer", self.accelerometer), ("gyro", self.gyro)):
                if not np.array_equal(own[k], mounting):
                    wrong[sensor].append(name)
        for sensor, names in wrong.items():
            every = len(names) == self.board.count
            whose = f"the {sensor} of {', '.join(names)}" if names else ""
            whose = f"every {sensor}" if every else whose
            found += [f"{whose}: other axes or signs than drawn"] if names else []
        if self.places is not None:
            found += self._of_places(self.places)
        return tuple(found)

    def _of_places(self, seen: Places) -> list[str]:
        found, names = [], self.board.imus
        if seen.other_unit:
            found.append(f"by the motion the array is {seen.size:.3g} times as large as drawn")
        moved = seen.exchanged.tolist()
        if len(moved) == 2:
            found.append(f"{names[moved[0]]} and {names[moved[1]]} are exchanged")
        else:
            found += [f"{names[k]} stands where {names[seen.place[k]]} is drawn" for k in moved]
        return found

    @property
    def gyros_alone(self) -> bool:
        """Whether all accelerometers and places are as drawn, or some gyros are."""
        same = np.eye(3)
        drawn = bool(np.all(self.accelerometer == same)) and self._places_fit is not False
        return drawn or bool(np.any(np.all(self.gyro == same, axis=(1, 2))))

    @property
    def accelerometers_alone(self) -> bool:
        """Whether all gyros are as drawn, and places that the motion shows."""
        return bool(np.all(self.gyro == np.eye(3))) and self._places_fit is True

    @property
    def _places_fit(self) -> bool | None:
        """None where the motion does not show them."""
        seen = self.places
        return None if seen is None else not (len(seen.exchanged) or seen.inverted)

    @property
    def lines(self) -> tuple[str, ...]:
        """Entries of the board file's `imus` that fit the log, those that differ from the file."""
        board, found = self.board, []
        spots = np.arange(board.count) if self.places is None else self.places.place
        size = self.places.size if self.places is not None and self.places.other_unit else 1.0
        for k, name in enumerate(board.imus):
            turn = self._mounting(k)
            own = self._own(k, turn.T @ self.accelerometer[k], turn.T @ self.gyro[k])
            before = self._own(k, np.eye(3), np.eye(3))
            if spots[k] != k or size != 1.0 or own != before or not np.array_equal(turn, np.eye(3)):
                position = ", ".join(f"{v:.6g}" for v in 1e3 * size * board.positions[spots[k]])
                mounting = _mounting_words(board.rotations[k] @ turn)
                found.append(f"  - {{name: {name}, position: [{position}], {mounting}{own}}}")
        return tuple(found)

    def _moved(self, k: int) -> bool:
        return self.places is not None and self.places.place[k] != k

    def _mounting(self, k: int) -> Array:
        """(3, 3) what the package's axes are turned by beside the drawing: those of the place at
        which it stands, or what both of its sensors say."""
        if self.places is not None and self._moved(k):
            turns = self.board.rotations
            return _signed(turns[k].T @ turns[self.places.place[k]])
        rate = self.gyro[k]
        whole = np.array_equal(self.accelerometer[k], rate) and np.linalg.det(rate) > 0.0
        return rate if whole else np.eye(3)

    def _own(self, k: int, acceleration: Array, rate: Array) -> str:
        """The keys of the sensors' own axes, after what the file says of them."""
        said = self.board.accelerometer_axes[k], self.board.gyro_axes[k]
        keys = zip(("accelerometer_axes", "gyro_axes"), said, (acceleration, rate), strict=True)
        return "".join(
            f', {key}: "{in_words(more @ old)}"'
            for key, old, more in keys
            if not np.array_equal(more @ old, np.eye(3))
        )


def _mounting_words(rotation: Array) -> str:
    if np.allclose(np.abs(rotation).max(axis=1), 1.0, atol=1e-9):
        return f'axes: "{in_words(rotation)}"'
    return f"rotation: {np.round(rotation, 9).tolist()}"


def compared(log: ArrayLog, segments: Segments, board: Board, order: list[int]) -> Drawn:
    """The board file as the log sees it. order : the board's IMUs in the segments' triads."""
    turns, same = board.rotations, np.tile(np.eye(3), (board.count, 1, 1))
    if segments.n < _FEW:
        return Drawn(board, same, same, None)
    still = np.einsum("kij,nkj->nki", turns, segments.mean[:, order])
    acceleration = relative_axes(still, turns)
    offset = np.einsum("kij,nkj->nki", turns, segments.rate[:, order]).mean(axis=0)
    speed = np.median(np.linalg.norm(log.rate, axis=2), axis=1)
    usable = (speed > SLOWEST) & ~log.clipped
    rows = np.flatnonzero(usable)
    if len(rows) < _SAMPLES // 100:
        return Drawn(board, acceleration, same, None)
    some = rows[:: max(len(rows) // _SAMPLES, 1)]
    gyro = relative_axes(log.rate[some] - offset, turns)
    shown = _Shown(
        log=log, segments=segments, board=board, still=still, gyro=gyro, offset=offset,
        usable=usable,
    )  # fmt: skip
    found = shown.with_accelerometers(acceleration)
    if found.gyros_alone:
        return found
    # All accelerometers wired alike contradict all gyros, and each other where packages differ.
    for own in SIGNED[1:]:
        every = np.broadcast_to(own, same.shape)
        if np.array_equal(relative_axes(_turned(still, turns, every), turns), same):
            other = shown.with_accelerometers(every)
            if other.accelerometers_alone:
                return other
    return found


@dataclass(frozen=True)
class _Shown:
    """What the log shows beside the accelerometers' axes. still : (m, K, 3) forces at rest; gyro :
    (K, 3, 3) axes relative to each other; offset : (K, 3); usable : (n,) neither clipped nor slow;
    still and offset as drawn, in board axes"""

    log: ArrayLog
    segments: Segments
    board: Board
    still: Array
    gyro: Array
    offset: Array
    usable: Flags

    def with_accelerometers(self, own: Array) -> Drawn:
        """The board file as it is seen where accelerometers read by `own` (K, 3, 3)."""
        log, turns = self.log, self.board.rotations
        force, still = _turned(log.acceleration, turns, own), _turned(self.still, turns, own)
        rate = _turned(log.rate, turns, self.gyro) - _turned(self.offset[None], turns, self.gyro)
        mean, ends = rate.mean(axis=1), (self.segments.start, self.segments.stop)
        common = common_gyro_axes(log.t, mean, still.mean(axis=1), *ends)
        gyro = _signed(turns.transpose(0, 2, 1) @ common @ turns @ self.gyro)
        where = None
        if in_its_unit(still):
            where = places(
                log.t, force, mean @ common.T, self.usable,
                drawn=self.board.positions, mounted=turns,
            )  # fmt: skip
        if where is not None and where.inverted:
            own = -own
        return Drawn(self.board, np.asarray(own), gyro, where)


def _signed(matrix: Array) -> Array:
    """Signed permutations as whole numbers, where mountings are such; else as they are."""
    whole = np.round(matrix)
    return np.asarray(np.where(np.abs(matrix - whole).max() < 1e-6, whole, matrix))


def _turned(values: Array, turns: Array, own: Array) -> Array:
    """Vectors (n, K, 3) in board axes with each package's axes (K, 3, 3) put right."""
    return np.asarray(np.einsum("kij,nkj->nki", turns @ own @ turns.transpose(0, 2, 1), values))


def refuse_contradiction(found: Drawn, agreeing: Sequence[str] = ()) -> None:
    """Raise Undetermined with the lines of the board file that fit the log. agreeing : other logs
    that the board file fits as it is, so that it must not be changed for this one."""
    if not found.faults:
        return
    lines = found.lines
    more = f"\n  # and {len(lines) - _SHOWN} more" if len(lines) > _SHOWN else ""
    what = "in the board file write these lines for theirs (--as-drawn keeps it as it is)"
    if agreeing:
        what = (
            f"the board file fits {', '.join(agreeing)} as it is, and one holds for all logs: "
            "leave this one out, or turn and exchange its sensors in the recording. Its own lines"
        )
    raise Undetermined(
        f"the recording contradicts the board file: {'; '.join(found.faults[:_SHOWN])}",
        remedy=f"{what}:\n" + "\n".join(lines[:_SHOWN]) + more,
    )
