"""A recording as an array sees it: all IMUs at the same instants, in the board's axes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.board.board import Board
from imucalib.errors import UnreadableInput
from imucalib.recording.pairing import list_names, names_in, pair
from imucalib.recording.recording import Channel, Recording
from imucalib.units import DEG

#: Share of the stated range from which a reading counts as clipped.
NEAR_RANGE = 0.998
#: Times that an extreme is read, and over the median size, if clipped.
_REPEATED, _FAR = 5, 3.0
#: Widths of a flat top as shares of its level, tried in turn; its consecutive readings at least;
#: flat tops of a sensor at least; and sample-to-sample drop beside one, in widths. Three readings
#: of a smooth turning point within one width have their neighbours within four.
_WIDTHS, _LONG, _TOPS, _DROP = (1e-3, 3e-3, 1e-2), 3, 3, 8.0
#: Standard deviations about the middle of flat tops within which readings are at the end; share of
#: where one direction of a sensor ends from which another that shows no flat top may.
_ABOUT, _ALIKE = 5.0, 0.97
_APART = 0.3  # share of a sample interval that simultaneous stamps may differ by
_KEPT = 0.5  # share of the samples that all IMUs must have in common
_SAME = 0.1  # of that difference, in the median, up to which they run on one clock


def at_end(values: Array) -> Flags:
    """(N,) samples with an axis at an extreme of values (N, 3) that it reads again and again, as no
    motion does: exactly, or within noise that came behind what saturates."""
    clipped, smooth = np.zeros(len(values), dtype=np.bool_), []
    for axis in values.T:
        usual = _FAR * float(np.median(np.abs(axis)))
        for along in (axis, -axis):
            end = float(along.max())
            if end <= usual or end <= 0.0:  # rests repeat readings, too
                continue
            at = along == end
            if int(at.sum()) >= _REPEATED:
                clipped |= at
            else:
                smooth.append(along)
    return clipped | _at_flat_tops(smooth, clipped)


def at_range(values: Array, limit: float) -> Flags:
    """(N,) samples with an axis of values (N, 3) at the stated range."""
    return np.asarray(np.any(np.abs(values) >= NEAR_RANGE * limit, axis=1))


def _at_flat_tops(directions: list[Array], none: Flags) -> Flags:
    """(N,) samples at flat tops of a sensor's directions, where it has enough of them; none : what
    is said where it has not."""
    for width in _WIDTHS:
        tops = [_flat_tops(along, width) for along in directions]
        if sum(len(own) for own in tops) < _TOPS:
            continue
        ends = [_end_of(np.concatenate(own), width) if own else np.inf for own in tops]
        most = _ALIKE * max(end for end in ends if np.isfinite(end))
        beyond = [
            a > (e if np.isfinite(e) else most) for a, e in zip(directions, ends, strict=True)
        ]
        return np.asarray(np.any(beyond, axis=0))
    return none


def _flat_tops(along: Array, share: float) -> list[Array]:
    """Consecutive readings of one direction that stay where a fast change led them: at its end."""
    end, width = float(along.max()), share * float(along.max())
    near = np.concatenate([[False], along > end - width, [False]])
    edges = np.flatnonzero(np.diff(near.astype(np.int8)))
    first, last = edges[::2], edges[1::2]  # the first reading, and the one after the last
    before, after = along[np.maximum(first - 1, 0)], along[np.minimum(last, len(along) - 1)]
    fell = np.minimum(before, after) < end - (_DROP + 1.0) * width
    return [along[a:b] for a, b, by in zip(first, last, fell, strict=True) if by and b - a >= _LONG]


def _end_of(read: Array, share: float) -> float:
    """From where on readings are at the end that flat tops have."""
    middle = float(np.median(read))
    spread = 1.4826 * float(np.median(np.abs(read - middle)))
    return middle - max(_ABOUT * spread, share * middle)


@dataclass(frozen=True)
class ArrayLog:
    """t : (N,) s; acceleration (m/s²) and rate (rad/s) : (N, K, 3) in board axes, uncalibrated;
    clipped : (N,) any axis of any sensor at its range; interval : s; notes : what was matched."""

    t: Array
    acceleration: Array
    rate: Array
    clipped: Flags
    interval: float
    notes: tuple[str, ...]


def of_board(recording: Recording, board: Board) -> tuple[Recording, Board]:
    """The recording's IMUs under the board's names and in their packages' axes, all others left
    out; and the board, named as the recording is where there is no drawing.

    `Channel.names` keeps what the recording calls them. Raises UnreadableInput for IMUs that do not
    match the board.
    """
    known = list(names_in(recording))
    if board.undrawn and len(known) == board.count:
        board = replace(board, imus=tuple(known))
    found = pair([(name,) for name in board.imus], recording, "the board")
    if len(found.partner) < board.count:
        absent = [n for k, n in enumerate(board.imus) if k not in found.partner.values()]
        raise UnreadableInput(
            f"the board has {board.count} IMUs, the recording {len(known)} "
            f"accelerometer{'s' * (len(known) != 1)} ({list_names(known) or 'none'}); "
            f"missing: {list_names(absent)}",
            where=recording.path,
            remedy="take them off the board file, or map all of them with --acc and --gyro",
        )
    own = {"acceleration": board.accelerometer_axes, "angular_rate": board.gyro_axes}
    named: dict[int, dict[str, Channel]] = {k: {} for k in range(board.count)}
    for channel in recording.channels.values():
        if (k := found.partner.get(channel.triad)) is None:
            continue
        values = channel.values
        if channel.quantity in own and not np.array_equal(own[channel.quantity][k], np.eye(3)):
            values = values @ own[channel.quantity][k].T
        own_name = () if channel.numbered else (channel.triad,)
        names = tuple(dict.fromkeys((*own_name, *channel.names)))
        named[k][f"{board.imus[k]}/{channel.quantity}"] = replace(
            channel, values=values, triad=board.imus[k], numbered=False, names=names
        )
    channels = {name: c for k in named for name, c in named[k].items()}
    return replace(recording, channels=channels, notes=(*recording.notes, *found.notes)), board


def array_log(recording: Recording, board: Board) -> ArrayLog:
    """All IMUs of the board side by side, of a recording as `of_board` gives it.

    Raises UnreadableInput for a missing gyro, a dead axis, or clocks or rates that do not match.
    """
    names, notes = board.imus, []
    chosen = [_channel(recording, n, q) for n in names for q in ("acceleration", "angular_rate")]
    t, indices, remark = _common_times(chosen, recording.path)
    notes += [remark] if remark else []
    read = np.empty((2, len(t), board.count, 3))
    clipped, finite = np.zeros(len(t), dtype=np.bool_), np.ones(len(t), dtype=np.bool_)
    for at, (channel, index) in enumerate(zip(chosen, indices, strict=True)):
        k, kind = divmod(at, 2)
        sensor, unit, size, limit = (
            ("accelerometer", "m/s²", 1.0, board.accelerometer_range),
            ("gyro", "deg/s", DEG, board.gyroscope_range),
        )[kind]
        values = channel.values[index]
        _refuse_dead(values, channel, recording.path)
        held = at_end(values)
        clipped |= held | at_range(values, limit)
        end = float(np.abs(values[held]).max(initial=0.0))
        if 0.0 < end < NEAR_RANGE * limit < np.inf:
            notes.append(
                f"the {sensor} of {names[k]} ends at {end / size:.4g} {unit}, which it reads "
                f"again and again, not at its range of {limit / size:.4g}: taken as clipped. "
                "State that range in the board file, for it holds for every log"
            )
        read[kind, :, k] = values @ board.rotations[k].T
        finite &= np.isfinite(values).all(axis=1)
    step = float(np.median(np.diff(t)))
    # A copy of a long recording only where something is left out.
    if not finite.all():
        notes.append(f"{int((~finite).sum())} samples with missing values left out")
        t, read, clipped = t[finite], read[:, finite], clipped[finite]
    return ArrayLog(t, read[0], read[1], clipped, step, tuple(notes))


def _channel(recording: Recording, triad: str, quantity: str) -> Channel:
    channel = recording.channels.get(f"{triad}/{quantity}")  # as `of_board` names them
    if channel is None:
        raise UnreadableInput(
            f"{triad} has no {quantity.replace('_', ' ')}",
            where=recording.path,
            remedy="every IMU of the array needs both; map it with --acc or --gyro",
        )
    if channel.unit != {"acceleration": "m/s2", "angular_rate": "rad/s"}[quantity]:
        raise UnreadableInput(
            f"{triad}/{quantity} is in {channel.unit or 'an unknown unit'}",
            where=recording.path,
            remedy="state its scale in a mapping (`imucal inspect --save-mapping`)",
        )
    return channel


def _common_times(channels: list[Channel], path: str) -> tuple[Array, list[Index], str]:
    """Instants that all channels have, and the sample of each channel there."""
    base = channels[0]
    if all(c.t.shape == base.t.shape and np.array_equal(c.t, base.t) for c in channels):
        every = np.arange(base.t.size)
        forward = np.concatenate([[True], np.diff(base.t) > 0.0])
        return base.t[forward], [every[forward]] * len(channels), ""
    rates = sorted({round(c.rate, 2) for c in channels})
    if rates[-1] > 1.05 * rates[0]:
        raise UnreadableInput(
            f"the channels have different rates, {rates[0]:g} to {rates[-1]:g} Hz",
            where=path,
            remedy="an array needs all IMUs at the same instants; record them at one rate",
        )
    tolerance = _APART / base.rate
    good = np.concatenate([[True], np.diff(base.t) > 0.0])
    indices, widest = [], 0.0
    for channel in channels:
        index = nearest(channel.t, base.t)
        apart = np.abs(channel.t[index] - base.t)
        good &= apart <= tolerance
        indices.append(index)
        widest = max(widest, float(np.median(apart)))
    # Stamps that agree tell readings that are missing from clocks that meet by chance.
    if good.mean() < _KEPT and widest > _SAME * tolerance:
        raise UnreadableInput(
            f"only {100 * good.mean():.0f} % of the samples have all IMUs within "
            f"{1e3 * tolerance:.3g} ms of each other",
            where=path,
            remedy="the IMUs need a common clock and trigger",
        )
    note = f"samples matched by their stamps (median difference {1e3 * widest:.3g} ms), "
    note += f"{int((~good).sum())} without a partner left out"
    return base.t[good], [i[good] for i in indices], note


def nearest(own: Array, t: Array) -> Index:
    """(n,) which of the instants `own` is nearest to each of t (n,)."""
    after = np.clip(np.searchsorted(own, t), min(1, len(own) - 1), len(own) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(own[before] - t) <= np.abs(own[after] - t), before, after)


def _refuse_dead(values: Array, channel: Channel, path: str) -> None:
    dead = [axis for k, axis in enumerate("xyz") if np.ptp(values[:, k]) == 0.0]
    if dead:
        raise UnreadableInput(
            f"{channel.triad}/{channel.quantity}: axis {', '.join(dead)} never changes",
            where=path,
            remedy="it is dead or not connected; take the IMU off the board file",
        )
