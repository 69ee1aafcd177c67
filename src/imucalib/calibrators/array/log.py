"""A recording as an array sees it: all IMUs at the same instants, in the board's axes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Flags
from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.range_ends import NEAR_RANGE, at_end, at_range
from imucalib.errors import UnreadableInput
from imucalib.recording.pairing import listed, names_in, paired
from imucalib.recording.recording import Channel, Recording
from imucalib.units import DEG

_APART = 0.3  # share of a sample interval that simultaneous stamps may differ by
_KEPT = 0.5  # share of the samples that all IMUs must have in common
_SAME = 0.1  # of that difference, in the median, up to which they run on one clock


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
    found = paired([(name,) for name in board.imus], recording, "the board")
    if len(found.partner) < board.count:
        absent = [n for k, n in enumerate(board.imus) if k not in found.partner.values()]
        raise UnreadableInput(
            f"the board has {board.count} IMUs, the recording {len(known)} "
            f"accelerometer{'s' * (len(known) != 1)} ({listed(known) or 'none'}); "
            f"missing: {listed(absent)}",
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
    chosen = [(_channel(recording, n, "acceleration"), _channel(recording, n, "angular_rate"))
              for n in names]  # fmt: skip
    t, indices, remark = _common_times([c for pair in chosen for c in pair], recording.path)
    notes += [remark] if remark else []
    turns = board.rotations
    shape = (len(t), board.count, 3)
    acceleration, rate = np.empty(shape), np.empty(shape)
    clipped, finite = np.zeros(len(t), dtype=np.bool_), np.ones(len(t), dtype=np.bool_)
    for k, (acc, gyro) in enumerate(chosen):
        a, g = acc.values[indices[2 * k]], gyro.values[indices[2 * k + 1]]
        _refuse_dead(a, names[k], "acceleration", recording.path)
        _refuse_dead(g, names[k], "angular_rate", recording.path)
        for values, limit, sensor, unit, size in (
            (a, board.accelerometer_range, "accelerometer", "m/s²", 1.0),
            (g, board.gyroscope_range, "gyro", "deg/s", DEG),
        ):
            held = at_end(values)
            clipped |= held | at_range(values, limit)
            end = float(np.abs(values[held]).max(initial=0.0))
            if 0.0 < end < NEAR_RANGE * limit < np.inf:
                notes.append(
                    f"the {sensor} of {names[k]} ends at {end / size:.4g} {unit}, which it reads "
                    f"again and again, not at its range of {limit / size:.4g}: taken as clipped. "
                    "State that range in the board file, for it holds for every log"
                )
        acceleration[:, k], rate[:, k] = a @ turns[k].T, g @ turns[k].T
        finite &= np.isfinite(a).all(axis=1) & np.isfinite(g).all(axis=1)
    step = float(np.median(np.diff(t)))
    # A copy of a long recording only where something is left out.
    if not finite.all():
        notes.append(f"{int((~finite).sum())} samples with missing values left out")
        t, acceleration, rate = t[finite], acceleration[finite], rate[finite]
        clipped = clipped[finite]
    return ArrayLog(t, acceleration, rate, clipped, step, tuple(notes))


def _channel(recording: Recording, triad: str, quantity: str) -> Channel:
    unit = {"acceleration": "m/s2", "angular_rate": "rad/s"}[quantity]
    for channel in recording.channels.values():
        if channel.triad == triad and channel.quantity == quantity:
            if channel.unit != unit:
                raise UnreadableInput(
                    f"{triad}/{quantity} is in {channel.unit or 'an unknown unit'}",
                    where=recording.path,
                    remedy="state its scale in a mapping (`imucal inspect --save-mapping`)",
                )
            return channel
    raise UnreadableInput(
        f"{triad} has no {quantity.replace('_', ' ')}",
        where=recording.path,
        remedy="every IMU of the array needs both; map it with --acc or --gyro",
    )


def _common_times(channels: list[Channel], path: str) -> tuple[Array, list[NDArray[np.intp]], str]:
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
        after = np.clip(np.searchsorted(channel.t, base.t), 1, channel.t.size - 1)
        nearer = np.abs(channel.t[after - 1] - base.t) <= np.abs(channel.t[after] - base.t)
        index = after - nearer
        apart = np.abs(channel.t[index] - base.t)
        good &= apart <= tolerance
        indices.append(index.astype(np.intp))
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


def _refuse_dead(values: Array, triad: str, quantity: str, path: str) -> None:
    dead = [axis for k, axis in enumerate("xyz") if np.ptp(values[:, k]) == 0.0]
    if dead:
        raise UnreadableInput(
            f"{triad}/{quantity}: axis {', '.join(dead)} never changes",
            where=path,
            remedy="it is dead or not connected; take the IMU off the board file",
        )
