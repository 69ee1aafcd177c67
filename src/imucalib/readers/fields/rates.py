"""The unit of angular rates: what no gyroscope reads, and what gravity says over turns
(`core.set_up`). A unit that nobody states is found so, and one that is refuted is refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from imucalib import units
from imucalib.arrays import Array, Flags
from imucalib.core.effect import rotations
from imucalib.core.set_up import DOUBT, SIGNED, axes_in_words, misfits, weigh
from imucalib.errors import UnreadableInput
from imucalib.readers.fields.conversion import UNKNOWN_RATE
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
#: A unit is refuted by this error (in the true one hand-turned logs have 0.4 to 2.2 deg).
_REFUTED = 10.0 * units.DEG
_TURNS, _SAMPLES = 12, 1 << 20  # that are looked at, of each sensor


def check_rates(
    blocks: Iterable[Recording], mapping: FieldMapping, *, fixed: bool
) -> Iterator[Recording]:
    """The same blocks, their angular rates looked at; in SI where no unit is stated and turns prove
    one, for which a million samples wait.

    fixed : whether the format itself fixes the unit: it is then never refused
    Raises UnreadableInput where the stated unit cannot be, with the option that settles it. A scale
    that the user gives (--gyro-lsb) is taken as it is.
    """
    if fixed or mapping.lsb_per_dps:
        yield from blocks
        return
    seen: dict[str, _Rates] = {}
    waiting = list[Recording]()
    for block in blocks:
        stated = str(block.mapping.get("gyro_unit", "")) or mapping.gyro_unit or "rad/s"
        for name, rate in block.channels.items():
            if rate.quantity == "angular_rate" and (rate.unit == "rad/s" or not mapping.gyro_unit):
                unit = units.canonical(stated) if rate.unit == "rad/s" else ""
                own = _Rates(unit, bool(mapping.gyro_unit), f"{block.path}, {name}")
                seen.setdefault(name, own)
        for name, own in seen.items():
            pair = (
                block.channels.get(f"{name.rpartition('/')[0]}/acceleration"),
                block.channels.get(name),
            )
            own.add(*pair)
        waiting.append(block)
        if not any(own.open for own in seen.values()):
            yield from _in_units_found(waiting, seen)
            waiting = []
    yield from _in_units_found(waiting, seen)


def _in_units_found(blocks: Sequence[Recording], seen: Mapping[str, _Rates]) -> Iterator[Recording]:
    """The blocks with those rates in SI whose unit nobody states and turns prove; the first says
    so."""
    if not blocks:
        return
    first = any(own.held for own in seen.values())
    found = {name: true for name, own in seen.items() if (true := own.close())}
    every = len(found) == sum(not own.unit for own in seen.values())
    for block in blocks:
        channels, notes, known = dict(block.channels), block.notes, dict(block.mapping)
        for name, (unit, sentence) in found.items():
            if name in channels:
                own, size = channels[name], units.RATE_UNITS[unit]
                channels[name] = replace(
                    own,
                    values=own.values * size,
                    unit="rad/s",
                    raw_unit=unit,
                    raw_to_si=(size,),
                )
            if first:
                notes = (*notes, f"{name}: {sentence}")
            known["gyro_unit"] = unit
        if found and every:
            notes = tuple(note for note in notes if not note.endswith(UNKNOWN_RATE))
        yield replace(block, channels=channels, notes=notes, mapping=known)
        first = False


@dataclass
class _Rates:
    """The rates of one sensor.

    unit : that is stated, or ""; by_user : who states it; where : of which channel
    turns : gravity before, after, and the rotations between them in every unit
    samples : so far; held : forces and rates that wait, where no unit is stated; found : it, and
    the sentence on it
    """

    unit: str
    by_user: bool
    where: str
    turns: list[tuple[Array, Array, Array]] = field(default_factory=list)
    samples: int = 0
    held: list[tuple[Channel | None, Channel | None]] = field(default_factory=list)
    found: tuple[str, str] | None = None
    closed: bool = False

    @property
    def open(self) -> bool:
        """Whether its unit is still sought."""
        return not (self.unit or self.closed or self.samples >= _SAMPLES)

    def _factors(self) -> dict[str, float]:
        """What turns a value in SI into the one that it would be in a unit, the stated one first;
        none where each axis has its own."""
        if not self.unit:  # as yet in none
            return dict(units.RATE_UNITS)
        own = units.RATE_UNITS.get(self.unit)
        others = {n: size / own for n, size in units.RATE_UNITS.items() if own and n != self.unit}
        return {self.unit: 1.0, **others} if own else {}

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

    def add(self, force: Channel | None, rate: Channel | None) -> None:
        """Take consecutive samples. Raises UnreadableInput where no such sensor reads them in the
        unit that is stated, or where turns refute it and prove another."""
        if self.unit and rate is not None and rate.t.size >= _IN_A_ROW:
            self.demand_slow(rate)
        if self.closed or len(self.turns) >= _TURNS or self.samples >= _SAMPLES:
            return
        self.samples += rate.t.size if rate is not None else 0
        if not self.unit:  # a turn may go on in the next block
            self.held.append((force, rate))
        elif force is not None and rate is not None and self._factors():
            self._look(force.t, force.values, rate.t, rate.values)
            self._demand_unrefuted()

    def _demand_unrefuted(self) -> None:
        chance, off = self._weigh()
        best = int(np.argmax(chance.sum(axis=1)))
        least = float(off[best].min())
        proven = chance[0].sum() <= DOUBT and chance[best].sum() >= 1.0 - DOUBT
        if proven and least < _REFUTED < off[0, 0]:
            true = list(self._factors())[best]
            what = (
                f"over {len(self.turns)} turns between rests the angular rate carries gravity "
                f"{off[0, 0] / units.DEG:.0f} deg past where it is, {least / units.DEG:.2g} deg in "
                f"{true},"
            )
            raise self._refused(what, true)

    def _look(self, at: Array, acc: Array, t: Array, rate: Array) -> None:
        if min(at.size, t.size) < _IN_A_ROW:
            return
        if not np.array_equal(at, t):
            acc = np.column_stack([np.interp(t, at, axis) for axis in acc.T])
        self.turns += carry_gravity(t, acc, rate, np.array(list(self._factors().values())))

    def _weigh(self) -> tuple[Array, Array]:
        """(k, 48) chance of each unit in each axes, and the median misfit, rad."""
        if not self.turns:
            count = len(self._factors())
            return np.full((count, 48), 1.0 / (48 * count)), np.zeros((count, 48))
        off = misfits(*map(np.array, zip(*self.turns, strict=True)))
        return weigh(off, stated=bool(self.unit)), np.median(off, axis=0)

    def close(self) -> tuple[str, str] | None:
        """The unit that turns prove where nobody states one, and the sentence on it."""
        held, self.held = self.held, []
        self.closed = self.closed or not self.unit
        pairs = [[c for c in channels if c is not None] for channels in zip(*held, strict=True)]
        if not pairs or not all(pairs):
            return self.found
        force, rate = ([np.concatenate(p) for p in zip(*((c.t, c.values) for c in cs), strict=True)]
                       for cs in pairs)  # fmt: skip
        self._look(*force, *rate)
        chance, off = self._weigh()
        best = int(np.argmax(chance.sum(axis=1)))
        least = float(off[best].min())
        if chance[best].sum() >= 1.0 - DOUBT and least < _REFUTED:
            unit, degrees = list(self._factors())[best], f"{least / units.DEG:.2g} deg"
            axes = axes_in_words(SIGNED[int(np.argmax(chance[best]))])
            turned = f" where its axes are {axes}" if axes != "x,y,z" else ""
            said = f"no unit is stated; over {len(self.turns)} turns between rests it carries"
            self.found = unit, f"{said} gravity to {degrees} in {unit}{turned}, and is read so"
        return self.found


def carry_gravity(
    t: Array, acc: Array, rate: Array, factors: Array
) -> list[tuple[Array, Array, Array]]:
    """Of every turn between two rests gravity before and after it, unit vectors, and the rotations
    (k, 2, 3, 3) between them by rates times each factor, and by the opposite ones.

    t : (n,) s; acc, rate : (n, 3), rad/s; at most `_TURNS` turns
    """
    step = float(np.median(np.diff(t)))
    width = max(4, round(_WINDOW / step)) if step > 0.0 else 0
    if not width or t.size < 4 * width or not np.isfinite(acc).all() or not np.isfinite(rate).all():
        return []
    rests = _rests(t, acc, rate, width=width, step=step)
    signed = np.stack([factors, -factors], axis=1).reshape(-1, 1, 1)
    found = list[tuple[Array, Array, Array]]()
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
        found.append((before, after, _turn(signed * vectors).reshape(-1, 2, 3, 3)))
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


def _turn(vectors: Array) -> Array:
    """(k, 3, 3) R of rotation vectors (k, n, 3), one after the other."""
    turns = rotations(vectors)
    while turns.shape[1] > 1:
        if turns.shape[1] % 2:
            turns = np.concatenate(
                [turns, np.broadcast_to(np.eye(3), (len(turns), 1, 3, 3))], axis=1
            )
        turns = turns[:, ::2] @ turns[:, 1::2]
    return np.asarray(turns[:, 0])
