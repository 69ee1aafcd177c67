"""Where a sensor reads the end of what it can read, whatever range is stated."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array, Flags

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
