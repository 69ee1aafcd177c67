"""The board file against the log, before anything is fitted; what differs ends with its lines.

Sensors of one rigid board see one gravity at rest and one angular rate in motion. Where a sensor's
axes are not as drawn, one of the 48 signed permutations of them brings it back to the others;
gravity turns from rest to rest as the gyros say. Places are those of
a_k - mean = W(ω, dω/dt) (r_k - mean) with the gyros' rate and its differences: good to a millimetre
without any calibration, enough to tell one place of the drawing from another.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.board.board import Board
from imucalib.calibrators.array.board.log import ArrayLog
from imucalib.calibrators.array.board.moving import SLOWEST
from imucalib.calibrators.array.board.turns import between, compose_rotations
from imucalib.core.effect import cross_matrix
from imucalib.core.set_up import SIGNED, axes_in_words
from imucalib.errors import Undetermined
from imucalib.rests.segments import Segments

_ALIKE = 0.9  # agreement that the right permutation reaches
_APART = 0.02  # by which the axes as drawn must miss perfect agreement
_CLEARER = 20.0  # times as far from perfect agreement as the right permutation
_TURNED = np.cos(np.radians(10.0))  # of two rests' directions, below which they differ
_TURNS = 4  # from rest to rest that show how the gyros turn
_FITS, _MISSES, _NEAR = 0.25, 4.0, 0.02  # rad, ratio, rad: what the right axes miss, and others
_GAP = 3.0  # sample intervals from which on some are missing
_FEWEST = 60  # moving samples from which a drawing is held against the log
_CLEARER_PLACES = 4.0  # times that another order must lower the squared distance of those that move
_EXPLAINED = 0.3  # share of the differences that places must explain
_SIZE = 2.0  # factor between the sizes of board and drawing that is another unit of length
_RATES = 500.0  # and that from which it is one of the rates: the size goes with their square
_GRAVITY = 4.0, 20.0  # m/s² between which the force at rest must lie to be in its unit
#: m, of each place about the first look: wide enough to say nothing, so that it counts once.
_WIDE = 0.02
_FEW = 3  # rests that show a frame
_SAMPLES = 4000  # moving samples that are looked at
_SHOWN = 8  # lines of a message


def relative_axes(seen: Array, rotations: Array) -> Array:
    """(K, 3, 3) S of each sensor: `rotation S reading` agrees with what most others see.

    seen : (n, K, 3) rotation · reading, in board axes; rotations : (K, 3, 3) package to board.
    S is the identity where the axes are as drawn, or where these vectors cannot tell.
    """
    size = np.maximum(np.sqrt(np.sum(seen**2, axis=(0, 2))), 1e-300)
    each = np.einsum("nja,nkb->jkab", seen, seen, optimize=True)
    each /= np.outer(size, size)[..., None, None]
    turned = rotations[:, None] @ SIGNED @ rotations.transpose(0, 2, 1)[:, None]
    score = np.einsum("kpab,jkab->jkp", turned, each, optimize=True)
    best = np.argmax(score, axis=2)
    right, drawn = 1.0 - score.max(axis=2), 1.0 - score[..., 0]
    clear = (right < 1.0 - _ALIKE) & (drawn > _APART) & (drawn > _CLEARER * right)
    reference = int(np.argmin(clear.sum(axis=1)))
    return np.asarray(SIGNED[np.where(clear[reference], best[reference], 0)])


def common_gyro_axes(t: Array, rate: Array, still: Array, start: Array, stop: Array) -> Array:
    """(3, 3) signed permutation of the rate that turns gravity from each rest to the next.

    t : (n,) s; rate : (n, 3) rad/s, mean over the gyros; still : (m, 3) specific force at m rests
    from start to stop (m,) s. The identity where that fits, or where too little says so.
    """
    from scipy.spatial.transform import Rotation

    up, off = still / np.linalg.norm(still, axis=1, keepdims=True), []
    for k, part in enumerate(between(t, start, stop, _GAP)):
        if not part.size or float(up[k] @ up[k + 1]) >= _TURNED:
            continue
        # A vector that stands still in space: du/dt = -ω x u, by a rate permuted in every way.
        small = -0.5 * (rate[part[1:]] + rate[part[:-1]]) * np.diff(t[part])[:, None]
        every = np.einsum("pij,nj->pni", SIGNED, small)
        turns = Rotation.from_rotvec(every.reshape(-1, 3)).as_matrix().reshape(48, -1, 3, 3)
        off.append(np.linalg.norm(compose_rotations(turns) @ up[k] - up[k + 1], axis=1))
    if len(off) < _TURNS:
        return np.eye(3)
    miss = np.median(off, axis=0)
    best = int(np.argmin(miss))
    clear = miss[best] < _FITS and miss[0] > _MISSES * max(float(miss[best]), _NEAR)
    return np.asarray(SIGNED[best if clear else 0])


@dataclass(frozen=True)
class Places:
    """place : (K,) of the drawing at which each IMU stands; size : of the array over the drawing's;
    inverted : whether all accelerometers read with the other sign"""

    place: Index
    size: float
    inverted: bool

    @property
    def exchanged(self) -> list[int]:
        return [k for k, place in enumerate(self.place) if place != k]

    @property
    def other_unit(self) -> bool:
        return _SIZE < max(self.size, 1.0 / self.size) < _RATES


def places(
    t: Array, force: Array, rate: Array, usable: Flags, *, drawn: Array, mounted: Array
) -> Places | None:
    """Places of K IMUs; None where the motion does not show them.

    t : (n,) s; force : (n, K, 3) m/s² and rate : (n, 3) rad/s in board axes; usable : (n,) neither
    clipped nor slow; drawn : (K, 3) m; mounted : (K, 3, 3), package to board
    """
    from scipy.optimize import linear_sum_assignment

    seen = rough_places(t, force, rate, usable)
    if seen is None:
        return None
    drawn = drawn - drawn.mean(axis=0)
    size = float(np.sqrt(np.sum(seen**2) / np.sum(drawn**2)))
    scaled = seen if 1.0 / _SIZE < size < _SIZE else seen / size
    apart = np.sum((scaled[:, None] - drawn) ** 2, axis=2)
    as_drawn, mirrored = np.diag(apart), float(np.sum((scaled + drawn) ** 2))
    if _CLEARER_PLACES * mirrored < float(as_drawn.sum()):
        # Sensors in another order are likelier than all of them with the other sign.
        place, off = _in_another_order(scaled, drawn, mounted)
        if off <= _CLEARER_PLACES * mirrored:
            return Places(place, size, inverted=False)
        return Places(np.arange(len(seen)), size, inverted=True)
    place = np.asarray(linear_sum_assignment(apart)[1], np.intp)
    moved = place != np.arange(len(place))
    nearer = apart[moved, place[moved]]
    if _CLEARER_PLACES * float(nearer.sum()) > float(as_drawn[moved].sum()):
        place = np.arange(len(place))
    return Places(place, size, inverted=False)


def rough_places(t: Array, force: Array, rate: Array, usable: Flags) -> Array | None:
    """(K, 3) m about their mean, good to a millimetre; None where the motion does not show them.
    Arguments as of `places`."""
    step = float(np.median(np.diff(t)))
    regular = np.abs(t[2:] - t[:-2] - 2.0 * step) < 0.3 * step
    rows = 1 + np.flatnonzero(usable[1:-1] & usable[:-2] & usable[2:] & regular)
    if len(rows) < _FEWEST:
        return None
    spin = (rate[rows + 1] - rate[rows - 1]) / (t[rows + 1] - t[rows - 1])[:, None]
    turning = cross_matrix(rate[rows])
    columns = np.zeros((len(rows), 3, 6))  # a position, and what a bias adds
    columns[..., :3], columns[..., 3:] = turning @ turning + cross_matrix(spin), np.eye(3)
    off = force[rows] - force[rows].mean(axis=1, keepdims=True)
    flat = columns.reshape(-1, 6)
    value = off.transpose(0, 2, 1).reshape(len(flat), -1)
    found = np.linalg.lstsq(flat, value, rcond=None)[0]
    moved = value - flat[:, 3:] @ found[3:]
    if np.sum((value - flat @ found) ** 2) > (1.0 - _EXPLAINED) * np.sum(moved**2):
        return None
    return np.asarray(found[:3].T - found[:3].mean(axis=1))


def _in_another_order(seen: Array, drawn: Array, mounted: Array) -> tuple[Index, float]:
    """(K,) places of the drawing in the order that fits best as a whole, and m² by which it does
    not: mountings go with places, so all readings are turned alike."""
    from scipy.optimize import linear_sum_assignment

    found, least = np.arange(len(seen)), np.inf
    turns = np.einsum("kij,lmj->klim", mounted, mounted)  # what k reads, mounted as l is
    for turn in turns[0]:
        alike = np.abs(turns - turn).max(axis=(2, 3)) < 1e-6
        apart = np.sum((seen[:, None] - drawn @ turn.T) ** 2, axis=2)
        cost = np.where(alike, apart, 1e6)
        rows, place = linear_sum_assignment(cost)
        if (off := float(cost[rows, place].sum())) < least:
            found, least = np.asarray(place, np.intp), off
    return found, least


def board_from_log(log: ArrayLog, segments: Segments, board: Board) -> Board:
    """The board in the axes of its first IMU. log : of the undrawn board, in the packages' axes.

    Raises Undetermined where axes are no signed permutations of each other, or where the motion
    does not show the places.
    """
    still, offset = segments.mean, segments.rate.mean(axis=0)
    usable = _usable(log)
    acceleration, gyro = (
        signed[0].T @ signed  # relative to the first IMU's, which are the board's
        for signed in (
            relative_axes(still, board.rotations),
            relative_axes((log.rate - offset)[usable], board.rotations),
        )
    )
    force, up = (
        _turn_each(log.acceleration, acceleration),
        _turn_each(still, acceleration).mean(axis=1),
    )
    rate = _turn_each(log.rate - offset, gyro).mean(axis=1)
    common = common_gyro_axes(log.t, rate, up, segments.start, segments.stop)
    gyro = common @ gyro
    seen = rough_places(log.t, force, rate @ common.T, usable)
    if seen is None:
        raise Undetermined(
            "without a drawing the motion must show where the IMUs are about, and it does not",
            remedy="twist the board faster about all axes, or give a board file",
        )
    rotations = gyro.copy()
    rotations[np.linalg.det(gyro) < 0.0] = acceleration[np.linalg.det(gyro) < 0.0]
    rotations[np.linalg.det(rotations) < 0.0] = np.eye(3)
    back = rotations.transpose(0, 2, 1)
    return replace(
        board,
        positions=seen,
        rotations=rotations,
        prior_sd=_WIDE,
        accelerometer_axes=back @ acceleration,
        gyro_axes=back @ gyro,
    )


def _usable(log: ArrayLog) -> Flags:
    """(N,) samples that are neither clipped nor slow."""
    speed = np.median(np.linalg.norm(log.rate, axis=2), axis=1)
    return np.asarray((speed > SLOWEST) & ~log.clipped)


def _turn_each(values: Array, turns: Array) -> Array:
    """Vectors (n, K, 3), each IMU's by its own matrix (K, 3, 3)."""
    return np.asarray(np.einsum("kij,nkj->nki", turns, values))


@dataclass(frozen=True)
class Drawn:
    """What the log says of a board file.

    accelerometer, gyro : (K, 3, 3) signed permutations of each package's axes, the identity where
    the drawing is right; places : or None where the motion does not show them
    """

    board: Board
    accelerometer: Array
    gyro: Array
    places: Places | None = None

    @property
    def faults(self) -> tuple[str, ...]:
        """What contradicts the board file, in words; empty where it fits."""
        names, found = self.board.imus, []
        mountings = [self._mounting(k) for k in range(len(names))]
        for k, name in enumerate(names):
            if k not in self._exchanged and not np.array_equal(mountings[k], np.eye(3)):
                found.append(f"{name} is mounted otherwise")
        for sensor, own in (("accelerometer", self.accelerometer), ("gyro", self.gyro)):
            wrong = [n for n, s, m in zip(names, own, mountings, strict=True) if (s != m).any()]
            every = len(wrong) == len(names)
            whose = f"every {sensor}" if every else f"the {sensor} of {', '.join(wrong)}"
            found += [f"{whose}: other axes or signs than drawn"] if wrong else []
        if self.places is not None:
            found += self._faults_of_places(self.places)
        return tuple(found)

    def _faults_of_places(self, seen: Places) -> Iterator[str]:
        names, moved = self.board.imus, seen.exchanged
        if seen.other_unit:
            yield f"by the motion the array is {seen.size:.3g} times as large as drawn"
        if len(moved) == 2:
            yield f"{names[moved[0]]} and {names[moved[1]]} are exchanged"
        else:
            yield from (f"{names[k]} stands where {names[seen.place[k]]} is drawn" for k in moved)

    @property
    def lines(self) -> tuple[str, ...]:
        """Entries of the board file's `imus` that fit the log, those that differ from the file."""
        board, seen, found = self.board, self.places, []
        size = seen.size if seen is not None and seen.other_unit else 1.0
        for k, name in enumerate(board.imus):
            turn, spot = self._mounting(k), k if seen is None else seen.place[k]
            own = self._axes(k, turn.T @ self.accelerometer[k], turn.T @ self.gyro[k])
            same = spot == k and size == 1.0 and np.array_equal(turn, np.eye(3))
            if not same or own != self._axes(k, np.eye(3), np.eye(3)):
                position = ", ".join(f"{v:.6g}" for v in 1e3 * size * board.positions[spot])
                mounting = _mounting_words(board.rotations[k] @ turn)
                found.append(f"  - {{name: {name}, position: [{position}], {mounting}{own}}}")
        return tuple(found)

    @property
    def _exchanged(self) -> list[int]:
        return [] if self.places is None else self.places.exchanged

    def _mounting(self, k: int) -> Array:
        """(3, 3) what the package's axes are turned by against the drawing: those of the place at
        which it stands, or what both of its sensors say."""
        if self.places is not None and k in self._exchanged:
            turns = self.board.rotations
            return _sign(turns[k].T @ turns[self.places.place[k]])
        rate = self.gyro[k]
        whole = np.array_equal(self.accelerometer[k], rate) and np.linalg.det(rate) > 0.0
        return rate if whole else np.eye(3)

    def _axes(self, k: int, acceleration: Array, rate: Array) -> str:
        """The keys of the sensors' own axes, after what the file says of them."""
        own = acceleration @ self.board.accelerometer_axes[k], rate @ self.board.gyro_axes[k]
        return "".join(
            f', {key}: "{axes_in_words(axes)}"'
            for key, axes in zip(("accelerometer_axes", "gyro_axes"), own, strict=True)
            if not np.array_equal(axes, np.eye(3))
        )


def _mounting_words(rotation: Array) -> str:
    if np.allclose(np.abs(rotation).max(axis=1), 1.0, atol=1e-9):
        return f'axes: "{axes_in_words(rotation)}"'
    return f"rotation: {np.round(rotation, 9).tolist()}"


def _sign(matrix: Array) -> Array:
    """Signed permutations as whole numbers, where mountings are such; else as they are."""
    whole = np.round(matrix)
    return np.asarray(np.where(np.abs(matrix - whole).max() < 1e-6, whole, matrix))


def check_board(log: ArrayLog, segments: Segments, board: Board) -> Drawn:
    """The board file as the log sees it."""
    turns, same = board.rotations, np.tile(np.eye(3), (board.count, 1, 1))
    back = turns.transpose(0, 2, 1)
    if segments.n < _FEW:
        return Drawn(board, same, same)
    still = _turn_each(segments.mean, turns)
    acceleration = relative_axes(still, turns)
    offset = _turn_each(segments.rate, turns).mean(axis=0)
    usable = _usable(log)
    rows = np.flatnonzero(usable)
    if len(rows) < _SAMPLES // 100:
        return Drawn(board, acceleration, same)
    some = rows[:: max(len(rows) // _SAMPLES, 1)]
    gyro = relative_axes(log.rate[some] - offset, turns)
    rate = _turn_each(log.rate - offset, turns @ gyro @ back).mean(axis=1)

    def where_forces_are_read_by(own: Array) -> Drawn:
        force, up = (_turn_each(v, turns @ own @ back) for v in (log.acceleration, still))
        common = common_gyro_axes(log.t, rate, up.mean(axis=1), segments.start, segments.stop)
        size = np.median(np.linalg.norm(up, axis=2), axis=0)
        seen = None
        if np.all((size > _GRAVITY[0]) & (size < _GRAVITY[1])):
            seen = places(
                log.t, force, rate @ common.T, usable, drawn=board.positions, mounted=turns
            )
        own = -own if seen is not None and seen.inverted else own
        return Drawn(board, own, _sign(back @ common @ turns @ gyro), seen)

    found = where_forces_are_read_by(acceleration)
    as_drawn, seen = np.array_equal(found.accelerometer, same), found.places
    if (as_drawn and not (seen and seen.exchanged)) or np.any(
        np.all(found.gyro == np.eye(3), axis=(1, 2))
    ):
        return found
    # All accelerometers wired alike contradict all gyros, and each other where packages differ.
    for own in SIGNED[1:]:
        every = np.broadcast_to(own, same.shape)
        if np.array_equal(relative_axes(_turn_each(still, turns @ every @ back), turns), same):
            other = where_forces_are_read_by(every)
            seen = other.places
            fits = seen is not None and not (seen.exchanged or seen.inverted)
            if fits and np.array_equal(other.gyro, same):
                return other
    return found


def refuse_contradiction(found: Drawn, agreeing: Sequence[str]) -> None:
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
