"""Whether angular rates have the unit that is stated: what no gyroscope reads, and what turns say.

Between two rests gravity turns by the integral of the rate: u(k+1) = R' u(k). In the true unit that
holds to a degree or two; in another one the recording contradicts itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from imucalib import units
from imucalib.arrays import Array, Flags
from imucalib.errors import UnreadableInput
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Recording

#: rad/s. Consumer and industrial MEMS gyroscopes end at 4,000 deg/s (ICM-45686, LSM6DSV80X); a
#: gain that is wrong by a tenth reaches no further.
FASTEST = 4500.0 * units.DEG
_IN_A_ROW = 3  # samples: a turn lasts, a damaged number stands alone
_WINDOW, _LONGEST_TURN = 0.3, 15.0  # s; beyond, the bias moves
#: Of the quietest 4 % of windows: up to ten times their variance is still (measured on hand-turned
#: logs). A hundredth of gravity, or of the fastest turn, is still in any case.
_QUIETEST, _QUIET, _LITTLE = 0.04, 10.0**0.5, 0.01
_SEEN_TURN = 20.0 * units.DEG  # a smaller turn of gravity tells no factor
#: A unit is refuted by this error (in the true one hand-turned logs have 0.4 to 2.2 deg); another
#: one is proven where chance carries gravity as near once in a million recordings. No two sensors
#: are aligned better than a degree.
_REFUTED, _PROVEN, _ALIGNED = 10.0 * units.DEG, np.log(1e-6), 1.0 * units.DEG
_TURNS, _SAMPLES = 12, 1 << 20  # that are looked at, of each sensor


def with_checked_rates(
    blocks: Iterable[Recording], mapping: FieldMapping, *, fixed: bool
) -> Iterator[Recording]:
    """The same blocks, their angular rates looked at.

    fixed : whether the format itself fixes the unit: it is then never refused. Where no unit is
    stated, a note names the one that turns prove.
    Raises UnreadableInput where the stated unit cannot be, with the option that settles it. A scale
    that the user gives (--gyro-lsb) is taken as it is.
    """
    if fixed or mapping.lsb_per_dps:
        yield from blocks
        return
    seen: dict[str, _Rates] = {}
    for block in blocks:
        stated = str(block.mapping.get("gyro_unit", "")) or mapping.gyro_unit or "rad/s"
        notes = list[str]()
        for name, rate in block.channels.items():
            if rate.quantity != "angular_rate" or rate.t.size < _IN_A_ROW:
                continue
            if rate.unit != "rad/s" and mapping.gyro_unit:
                continue
            unit = units.canonical(stated) if rate.unit == "rad/s" else "counts"
            own = _Rates(unit, bool(mapping.gyro_unit), f"{block.path}, {name}")
            own = seen.setdefault(name, own)
            if unit != "counts":
                own.demand_slow(rate)
            force = block.channels.get(f"{rate.triad}/acceleration")
            if force is not None:
                # A damaged number may be of any size.
                with np.errstate(over="ignore", invalid="ignore"):
                    found = own.add(force, rate)
                notes += [f"{name}: {found}"] * bool(found)
        yield replace(block, notes=(*block.notes, *notes)) if notes else block


@dataclass
class _Rates:
    """The rates of one sensor.

    unit : that is stated, or "counts"; by_user : who states it; where : of which channel
    errors : of gravity carried over turns, by unit, rad; samples : that were looked at
    """

    unit: str
    by_user: bool
    where: str
    errors: list[Array] = field(default_factory=list)
    samples: int = 0

    def _factors(self) -> dict[str, float]:
        """What turns a value in SI into the one that it would be in another unit; none where each
        axis has its own."""
        if self.unit == "counts":  # as yet in none
            return dict(units.RATE_UNITS)
        own = units.RATE_UNITS.get(self.unit)
        others = (item for item in units.RATE_UNITS.items() if own and item[0] != self.unit)
        return {name: size / own for name, size in others if own}

    def _refused(self, what: str, true: str) -> UnreadableInput:
        """The error; `true` is the unit that fits, or empty."""
        who = "as --gyro-unit states" if self.by_user else "as the file states"
        option = f"--gyro-unit {true}" if true else "--gyro-unit"
        return UnreadableInput(
            f"{what} when its unit is {self.unit}, {who}",
            where=self.where,
            remedy=f"name the true unit with {option}, or a scale with --gyro-unit counts "
            "--gyro-lsb N",
        )

    def demand_slow(self, rate: Channel) -> None:
        """Refuse a rate that no such sensor reads, where it lasts."""
        low, high = rate.values.min(), rate.values.max()
        if max(-low, high) <= FASTEST:
            return
        size = np.abs(rate.values).max(axis=1)
        lasting = np.minimum(np.minimum(size[:-2], size[1:-1]), size[2:])
        fastest = float(lasting[np.isfinite(lasting)].max(initial=0.0))
        if fastest > FASTEST:
            true = "deg/s" if fastest * self._factors().get("deg/s", 1.0) <= FASTEST else ""
            what = (
                f"the angular rate reaches {fastest / units.DEG:,.0f} deg/s, and no MEMS gyroscope "
                f"reads above {FASTEST / units.DEG:,.0f},"
            )
            raise self._refused(what, true)

    def add(self, force: Channel, rate: Channel) -> str:
        """Take consecutive samples; raises where they refute the unit and prove another. Returns
        what they prove where none is stated, once."""
        factors = self._factors()
        if not factors or len(self.errors) >= _TURNS or self.samples >= _SAMPLES:
            return ""
        self.samples += rate.t.size
        acc, turn = force.values, rate.values
        if not np.array_equal(force.t, rate.t):
            if force.t.size < _IN_A_ROW:
                return ""
            acc = np.column_stack([np.interp(rate.t, force.t, axis) for axis in acc.T])
        self.errors += carried(rate.t, acc, turn, np.array([1.0, *factors.values()]))
        if not self.errors:
            return ""
        off, *others = np.median(self.errors, axis=0).tolist()
        best = int(np.argmin(others))
        least = max(others[best], _ALIGNED)
        chance = len(self.errors) * np.log((1.0 - np.cos(least)) / 2.0) + np.log(len(factors))
        if chance >= _PROVEN:
            return ""
        true = list(factors)[best]
        turns, angle = f"{len(self.errors)} turns between rests", f"{least / units.DEG:.2g} deg"
        if self.unit == "counts":
            self.samples = _SAMPLES
            return f"over {turns} it carries gravity to {angle} in {true}: give --gyro-unit {true}"
        if off > _REFUTED:
            what = (
                f"over {turns} the angular rate carries gravity {off / units.DEG:.0f} deg past "
                f"where it is, {angle} in {true},"
            )
            raise self._refused(what, true)
        return ""


def carried(t: Array, acc: Array, rate: Array, factors: Array) -> list[Array]:
    """Of every turn between two rests, the angle (rad) between gravity carried over it and gravity
    read after it, (k,) for rates times each factor.

    t : (n,) s; acc, rate : (n, 3), rad/s; at most `_TURNS` turns
    """
    step = float(np.median(np.diff(t)))
    width = max(4, round(_WINDOW / step)) if step > 0.0 else 0
    if not width or t.size < 4 * width or not np.isfinite(acc).all() or not np.isfinite(rate).all():
        return []
    rests = _rests(t, acc, rate, width=width, step=step)
    found = []
    for (_, a), (b, _) in pairwise(rests):
        ends = slice(a - width, a), slice(b, b + width)
        means = [acc[end].mean(axis=0) for end in ends]
        if not all(mean.any() for mean in means):  # filled in, or dead
            continue
        before, after = (mean / np.linalg.norm(mean) for mean in means)
        dt = np.diff(t[a - 1 : b + 1])
        angle = np.arccos(np.clip(before @ after, -1.0, 1.0))
        late = t[b] - t[a - 1] > _LONGEST_TURN or dt.max() > 5.0 * step or dt.min() < 0.0
        if angle < _SEEN_TURN or late:
            continue
        own = rate[a - 1 : b + 1] - 0.5 * (rate[ends[0]].mean(axis=0) + rate[ends[1]].mean(axis=0))
        vectors = 0.5 * (own[1:] + own[:-1]) * dt[:, None]
        there = _turned(before, factors[:, None, None] * vectors)
        found.append(np.arccos(np.clip(there @ after, -1.0, 1.0)))
        if len(found) == _TURNS:
            break
    return found


def _rests(t: Array, acc: Array, rate: Array, *, width: int, step: float) -> list[tuple[int, int]]:
    """Samples from, to (exclusive) of what is still for three windows and more, one less at each
    end: a turn begins slowly."""
    count = t.size // width
    shape = (count, width, 3)
    spread = [
        np.sqrt(x[: count * width].reshape(shape).var(axis=1).sum(axis=1)) for x in (acc, rate)
    ]
    little = _LITTLE * units.STANDARD_GRAVITY, _LITTLE * float(np.abs(rate).max())
    quiet: Flags = np.ones(count, dtype=np.bool_)
    for size, least in zip(spread, little, strict=True):
        quiet &= size <= max(_QUIET * float(np.quantile(size, _QUIETEST)), least)
    first = t[: count * width : width]
    quiet &= t[width - 1 : count * width : width] - first < 2.0 * width * step
    edges = np.flatnonzero(np.diff(np.concatenate([[False], quiet, [False]]).astype(np.int8)))
    pairs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [((a + 1) * width, (b - 1) * width) for a, b in pairs if b - a >= 3]


def _turned(before: Array, vectors: Array) -> Array:
    """(k, 3) a direction of the world in the body's axes after it turned by rotation vectors
    (k, n, 3), one after the other."""
    angle = np.linalg.norm(vectors, axis=2, keepdims=True)
    half = 0.5 * np.sinc(angle / (2.0 * np.pi))  # sin(angle / 2) / angle
    turns = np.concatenate([np.cos(0.5 * angle), half * vectors], axis=2)
    while turns.shape[1] > 1:
        if turns.shape[1] % 2:
            still = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (turns.shape[0], 1, 4))
            turns = np.concatenate([turns, still], axis=1)
        turns = _product(turns[:, ::2], turns[:, 1::2])
    real, axis = turns[:, 0, :1], -turns[:, 0, 1:]
    twice = 2.0 * np.cross(axis, before)
    return np.asarray(before + real * twice + np.cross(axis, twice))


def _product(one: Array, two: Array) -> Array:
    """Products of quaternions (..., 4)."""
    a, b, x, y = one[..., :1], two[..., :1], one[..., 1:], two[..., 1:]
    real = a * b - (x * y).sum(axis=-1, keepdims=True)
    return np.concatenate([real, a * y + b * x + np.cross(x, y)], axis=-1)
