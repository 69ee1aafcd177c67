"""A recording as an array sees it: all IMUs at the same instants, in the board's axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Flags
from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.range_ends import NEAR_RANGE, at_end, at_range
from imucalib.errors import UnreadableInput
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


def array_log(recording: Recording, board: Board) -> tuple[ArrayLog, Board]:
    """All IMUs of the board side by side, and the board in their order.

    Raises UnreadableInput for a missing IMU, a missing gyro, a dead axis, or clocks or rates that
    do not match.
    """
    names, notes = _matched_names(recording, board)
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
    return ArrayLog(t, acceleration, rate, clipped, step, tuple(notes)), board


def in_package_axes(recording: Recording, board: Board) -> Recording:
    """The recording with every sensor's axes those of its package, as the board file says. Raises
    UnreadableInput for IMUs that do not match the board."""
    own = {"acceleration": board.accelerometer_axes, "angular_rate": board.gyro_axes}
    names, channels = _matched_names(recording, board)[0], dict(recording.channels)
    for name, channel in recording.channels.items():
        if channel.triad in names and channel.quantity in own:
            turn = own[channel.quantity][names.index(channel.triad)]
            if not np.array_equal(turn, np.eye(3)):
                channels[name] = replace(channel, values=channel.values @ turn.T)
    return replace(recording, channels=channels)


def _matched_names(recording: Recording, board: Board) -> tuple[list[str], list[str]]:
    triads = list(dict.fromkeys(
        c.triad for c in recording.channels.values() if c.quantity == "acceleration"
    ))  # fmt: skip
    if set(board.imus) <= set(triads):
        left = [n for n in triads if n not in board.imus]
        notes = [f"not on the board, left out: {', '.join(left)}"] if left else []
        return list(board.imus), notes
    if len(triads) == board.count:
        return triads, [f"IMUs matched to the board in order: {', '.join(triads)}"]
    missing = [n for n in board.imus if n not in triads]
    raise UnreadableInput(
        f"the board has {board.count} IMUs, the recording {len(triads)} "
        f"accelerometer{'s' * (len(triads) != 1)} ({_few(triads) or 'none'}); "
        f"missing: {_few(missing)}",
        where=recording.path,
        remedy="name the IMUs of the board file like the recording's, or map all of them "
        "with --acc and --gyro",
    )


def _few(names: Sequence[str]) -> str:
    more = len(names) - 4
    return ", ".join(names[: 3 if more > 0 else 4]) + (f" and {more + 1} more" if more > 0 else "")


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
