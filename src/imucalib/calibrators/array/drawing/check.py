"""The board file against the log, before anything is fitted; what differs ends with its lines.

Accelerometers share gravity at rest, gyros the rate of one rigid board; gravity turns as the gyros
say; and the accelerometers' differences show who stands where.

Axes of an array's sensors against each other: signed permutations, told by what all share.

Sensors of one rigid board see one gravity at rest and one angular rate in motion. Where a sensor's
axes are not as drawn, one of the 48 signed permutations of them brings it back to the others.

Where IMUs are, by linear algebra on their accelerometers: exchanged places, another unit.

a_k - mean = W(ω, dω/dt) (r_k - mean) with the gyros' rate and its differences: good to a millimetre
without any calibration, enough to tell one place of the drawing from another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.log import ArrayLog
from imucalib.calibrators.array.moving import SLOWEST
from imucalib.core.effect import cross_matrix
from imucalib.errors import Undetermined
from imucalib.rests.segments import Segments

#: (48, 3, 3); the first is the identity.
SIGNED = np.array(
    [
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
)
_ALIKE = 0.9  # agreement that the right permutation reaches
_APART = 0.02  # by which the axes as drawn must miss perfect agreement
_CLEARER = 20.0  # times as far from perfect agreement as the right permutation
_TURNED = np.cos(np.radians(10.0))  # of two rests' directions, below which they differ
_TURNS = 4  # from rest to rest that show how the gyros turn
_FITS, _MISSES, _NEAR = 0.25, 4.0, 0.02  # rad, ratio, rad: what the right axes miss, and others


def relative_axes(seen: Array, rotations: Array) -> Array:
    """(K, 3, 3) S of each sensor: `rotation S reading` agrees with what most others see.

    seen : (n, K, 3) rotation · reading, in board axes; rotations : (K, 3, 3) package to board.
    S is the identity where the axes are as drawn, or where these vectors cannot tell.
    """
    size = np.maximum(np.sqrt(np.sum(seen**2, axis=(0, 2))), 1e-300)
    each = (
        np.einsum("nja,nkb->jkab", seen, seen, optimize=True)
        / np.outer(size, size)[..., None, None]
    )
    turned = rotations[:, None] @ SIGNED @ rotations.transpose(0, 2, 1)[:, None]
    score = np.einsum("kpab,jkab->jkp", turned, each, optimize=True)
    best = np.argmax(score, axis=2)
    right = 1.0 - np.take_along_axis(score, best[..., None], axis=2)[..., 0]
    drawn = 1.0 - score[..., 0]
    told = (right < 1.0 - _ALIKE) & (drawn > _APART) & (drawn > _CLEARER * right)
    reference = int(np.argmin(told.sum(axis=1)))
    return np.asarray(SIGNED[np.where(told[reference], best[reference], 0)])


def common_gyro_axes(t: Array, rate: Array, still: Array, start: Array, stop: Array) -> Array:
    """(3, 3) signed permutation of the rate that turns gravity from each rest to the next.

    t : (n,) s; rate : (n, 3) rad/s, mean over the gyros; still : (m, 3) specific force at m rests
    from start to stop (m,) s. The identity where that fits, or where too little says so.
    """
    up = still / np.linalg.norm(still, axis=1, keepdims=True)
    off = [
        np.linalg.norm(_turned_by(t[part], rate[part]) @ up[k] - up[k + 1], axis=1)
        for k, part in enumerate(_between(t, start, stop))
        if part.size and float(up[k] @ up[k + 1]) < _TURNED
    ]
    if len(off) < _TURNS:
        return np.eye(3)
    miss = np.median(off, axis=0)
    best = int(np.argmin(miss))
    told = miss[best] < _FITS and miss[0] > _MISSES * max(float(miss[best]), _NEAR)
    return np.asarray(SIGNED[best if told else 0])


def _between(t: Array, start: Array, stop: Array) -> list[Index]:
    """Samples from each rest to the next; none where some are missing between them."""
    step = float(np.median(np.diff(t)))
    ends = np.searchsorted(t, stop[:-1]), np.searchsorted(t, start[1:], side="right")
    spans = [np.arange(max(a - 1, 0), b) for a, b in zip(*ends, strict=True)]
    return [s if np.diff(t[s]).max(initial=0.0) < 3.0 * step else s[:0] for s in spans]


def _turned_by(t: Array, rate: Array) -> Array:
    """(48, 3, 3) what a rate, permuted in every way, does over a stretch to a vector that stands
    still in space, du/dt = -ω x u: small steps, multiplied in pairs."""
    from scipy.spatial.transform import Rotation

    small = -0.5 * (rate[1:] + rate[:-1]) * np.diff(t)[:, None]
    every = np.einsum("pij,nj->pni", SIGNED, small)
    turns = Rotation.from_rotvec(every.reshape(-1, 3)).as_matrix().reshape(48, -1, 3, 3)
    while turns.shape[1] > 1:
        if turns.shape[1] % 2:
            same = np.broadcast_to(np.eye(3), (48, 1, 3, 3))
            turns = np.concatenate([turns, same], axis=1)
        turns = turns[:, 1::2] @ turns[:, ::2]
    return np.asarray(turns[:, 0])


def in_words(signed: Array) -> str:
    """A signed permutation as the board file and mappings write it: "x,-y,z"."""
    at = np.argmax(np.abs(signed), axis=1)
    return ",".join(("-" if signed[i, k] < 0 else "") + "xyz"[k] for i, k in enumerate(at))


_FEWEST = 60
_CLEARER_PLACES = 4.0  # times that another order must lower the squared distance of those that move
_EXPLAINED = 0.3  # share of the differences that places must explain
_SIZE = 2.0  # factor between the sizes of board and drawing that is another unit of length
_RATES = 500.0  # and that from which it is one of the rates: the size goes with their square
_GRAVITY = 4.0, 20.0  # m/s² between which the force at rest must lie to be in its unit


@dataclass(frozen=True)
class Places:
    """seen : (K, 3) m by the motion, about their mean; place : (K,) of the drawing at which each
    IMU stands; size : of the array over the drawing's; inverted : whether all accelerometers read
    with the other sign"""

    seen: Array
    place: Index
    size: float
    inverted: bool

    @property
    def exchanged(self) -> Index:
        return np.flatnonzero(self.place != np.arange(len(self.place)))

    @property
    def other_unit(self) -> bool:
        factor = max(self.size, 1.0 / self.size)
        return _SIZE < factor < _RATES


def in_its_unit(still: Array) -> bool:
    """Whether readings (m, K, 3) m/s² at rest have about the size of gravity."""
    size = np.median(np.linalg.norm(still, axis=2), axis=0)
    return bool(np.all((size > _GRAVITY[0]) & (size < _GRAVITY[1])))


def places(
    t: Array, force: Array, rate: Array, usable: Flags, *, drawn: Array, mounted: Array
) -> Places | None:
    """Places of K IMUs; None where the motion does not show them.

    t : (n,) s; force : (n, K, 3) m/s² and rate : (n, 3) rad/s in board axes; usable : (n,) neither
    clipped nor slow; drawn : (K, 3) m; mounted : (K, 3, 3), package to board
    """
    seen = rough_places(t, force, rate, usable)
    return None if seen is None else _placed(seen, drawn - drawn.mean(axis=0), mounted)


def rough_places(t: Array, force: Array, rate: Array, usable: Flags) -> Array | None:
    """(K, 3) m about their mean, good to a millimetre; None where the motion does not show them."""
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


def _placed(seen: Array, drawn: Array, mounted: Array) -> Places:
    from scipy.optimize import linear_sum_assignment

    size = float(np.sqrt(np.sum(seen**2) / np.sum(drawn**2)))
    scaled = seen if 1.0 / _SIZE < size < _SIZE else seen / size
    apart = np.sum((scaled[:, None] - drawn) ** 2, axis=2)
    as_drawn = np.diag(apart)
    mirrored = float(np.sum((scaled + drawn) ** 2))
    inverted = _CLEARER_PLACES * mirrored < float(as_drawn.sum())
    if inverted:
        # Sensors in another order are likelier than all of them with the other sign.
        place, off = _in_another_order(scaled, drawn, mounted)
        if off <= _CLEARER_PLACES * mirrored:
            return Places(seen, place, size, inverted=False)
    place = np.asarray(linear_sum_assignment(apart)[1], np.intp)
    moved = place != np.arange(len(place))
    nearer = apart[np.arange(len(place)), place]
    if inverted or _CLEARER_PLACES * float(nearer[moved].sum()) > float(as_drawn[moved].sum()):
        place = np.arange(len(place))
    return Places(seen, place, size, inverted)


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
        place = np.asarray(linear_sum_assignment(cost)[1], np.intp)
        if (off := float(cost[np.arange(len(place)), place].sum())) < least:
            found, least = place, off
    return found, least


#: m, of each place about the first look: wide enough to say nothing, so that it counts once.
_WIDE = 0.02


def sketched(log: ArrayLog, segments: Segments, board: Board, order: list[int]) -> Board:
    """The board in the axes of its first IMU. log : of the undrawn board, in the packages' axes.

    Raises Undetermined where axes are no signed permutations of each other, or where the motion
    does not show the places.
    """
    turns = board.rotations
    still = segments.mean[:, order]
    usable = (np.median(np.linalg.norm(log.rate, axis=2), axis=1) > SLOWEST) & ~log.clipped
    acceleration = _to_the_first(relative_axes(still, turns))
    offset = segments.rate[:, order].mean(axis=0)
    gyro = _to_the_first(relative_axes((log.rate - offset)[usable], turns))
    force = np.einsum("kij,nkj->nki", acceleration, log.acceleration)
    rate = np.einsum("kij,nkj->nki", gyro, log.rate - offset)
    up = np.einsum("kij,nkj->nki", acceleration, still).mean(axis=1)
    common = common_gyro_axes(log.t, rate.mean(axis=1), up, segments.start, segments.stop)
    gyro = common @ gyro
    seen = rough_places(log.t, force, rate.mean(axis=1) @ common.T, usable)
    if seen is None:
        raise Undetermined(
            "without a drawing the motion must show where the IMUs are about, and it does not",
            remedy="twist the board faster about all axes, or give a board file",
        )
    proper = np.linalg.det(gyro) > 0.0
    rotations = np.where(proper[:, None, None], gyro, acceleration)
    if np.any(np.linalg.det(rotations) < 0.0):
        rotations = np.where(proper[:, None, None], rotations, np.eye(3))
    back = rotations.transpose(0, 2, 1)
    return replace(
        board,
        positions=seen,
        rotations=rotations,
        prior_sd=_WIDE,
        accelerometer_axes=back @ acceleration,
        gyro_axes=back @ gyro,
    )


def _to_the_first(signed: np.ndarray) -> np.ndarray:
    """Axes relative to the first IMU's, which are the board's."""
    return np.asarray(signed[0].T @ signed)


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
        log=log,
        segments=segments,
        board=board,
        still=still,
        gyro=gyro,
        offset=offset,
        usable=usable,
    )
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
                log.t,
                force,
                mean @ common.T,
                self.usable,
                drawn=self.board.positions,
                mounted=turns,
            )
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
