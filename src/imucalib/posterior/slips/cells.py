"""Readings of a sheet that are not what was read there: a cell, rows in the wrong place, axes.

At each point of noise the misfit is yᵀPy, P = V⁻¹ without what the model explains. For readings
that differ by D it is exactly

    RSS' = RSS + 2 Dᵀg + DᵀPD,  g = Py

so that every change is judged without a fit: a sign, a decimal point or two digits of one cell, two
cells or rows exchanged, one moved, a block shifted. Axes that are exchanged or inverted in all rows
from k on are a signed permutation Q; with z = Q y,

    RSS(k, Q) = Σ_{i,j<k} y_i P_ij y_j + 2 Σ_{i<k≤j} y_i P_ij z_j + Σ_{i,j≥k} z_i P_ij z_j

is a sum over corners of three tables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise, permutations, product

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.posterior.odds import (
    ANY_BLOCK,
    FEW,
    FIGURES,
    MOVED,
    OPEN,
    PART,
    SHORT_LIST,
    SLIPS,
    SOLVED_AGAIN,
    SPARE,
    WRONG,
)
from imucalib.posterior.search.explored import SearchedPosterior
from imucalib.posterior.search.gram import Grams, log_sum
from imucalib.posterior.sheet.conventions import axes_text, nearest_axes
from imucalib.posterior.sheet.sheet import Fault, Kind, Sheet, Trial
from imucalib.units import MG

_AXES = tuple(
    (np.array(order), np.array(sign))
    for order in permutations(range(3))
    for sign in product((1.0, -1.0), repeat=3)
    if (order, sign) != ((0, 1, 2), (1.0, 1.0, 1.0))
)


@dataclass(frozen=True)
class BaseProducts:
    """P : (G, 3n, 3n) at G noises; g : P y (G, 3n); rss : (G,); grams : where they come from
    response : (3, 3) what the sensor makes of a force, mg for mg"""

    sheet: Sheet
    P: Array
    g: Array
    rss: Array
    grams: Grams
    dof: float
    response: Array

    def misfit(self, rows: Index, change: Array) -> Array:
        """(G, h) RSS of sheets of which some readings differ by (h, k, 3) mg; rows : (k,) which, or
        (h, k) of each sheet"""
        at = (3 * rows[..., None] + np.arange(3)).reshape(*rows.shape[:-1], -1)
        change = change.reshape(len(change), -1)
        inner = self.P[:, at[..., :, None], at[..., None, :]]
        if rows.ndim == 1:
            pulled = change @ inner + 2.0 * self.g[:, None, at]
        else:
            pulled = np.einsum("hi,Ghij->Ghj", change, inner) + 2.0 * self.g[:, at]
        return np.asarray(self.rss[:, None] + np.einsum("Ghj,hj->Gh", pulled, change))

    def each(self, rss: Array) -> Array:
        """Log likelihood and prior at every noise for sums of squares (G, ...)."""
        weight = self.grams.log_weight.reshape((-1,) + (1,) * (rss.ndim - 1))
        return np.asarray(weight + self.grams.log_noise(np.maximum(rss, 1e-9), self.dof))

    def gain(self, rss: Array, count: float) -> Array:
        """(...) nats beyond the sheet as it stands, over all noises, less what one slip of `count`
        in its class pays for being one of them."""
        whole = log_sum(self.each(rss)) - log_sum(self.each(self.rss))
        return np.asarray(whole + prior_of(count))

    def at_few(self) -> BaseProducts:
        """The same at the likeliest noises only."""
        noises = np.argsort(-self.each(self.rss))[:FEW]
        return replace(
            self,
            P=self.P[noises],
            g=self.g[noises],
            rss=self.rss[noises],
            grams=self.grams.of(noises),
        )


def base_of(found: SearchedPosterior, sheet: Sheet, one: Grams) -> BaseProducts:
    """The base of a sheet of known angles; one : products beside the base model and a set, the
    readings' own numbers first."""
    fit = found.base
    unit = fit.at.unit / MG
    rows = one.rows(np.arange(unit.size))
    first = fit.observations.context.take(np.zeros(1, np.intp))
    response = fit.model.predict(fit.theta, np.zeros((1, 1, 3)), first).d_truth[0, 0]
    return BaseProducts(
        sheet=sheet,
        P=rows[:, :, : unit.size] / np.outer(unit, unit),
        g=rows[:, :, -1] / unit,
        rss=one.power,
        grams=one,
        dof=found.posterior.dof,
        response=response,
    )


def prior_of(count: float) -> float:
    """Log prior odds of one slip among `count` of its class."""
    return float(np.log(WRONG / SLIPS / count))


def select_leading(score: Array) -> Index:
    """Those that are worth being solved again, best first."""
    best = float(score.max(initial=-np.inf))
    order = np.argsort(-score)[:SOLVED_AGAIN]
    return order[score[order] > max(-OPEN / 3.0, best - OPEN)]


def _shortlist(
    base: BaseProducts, scores: Callable[[BaseProducts, Index], Array], count: int
) -> Iterator[tuple[int, float]]:
    """The leading ones of many hypotheses and their scores: looked at on the likeliest noises
    first, then the best of them on all."""
    short = np.argsort(-scores(base.at_few(), np.arange(count)))[:SHORT_LIST]
    score = scores(base, short)
    for k in select_leading(score):
        yield int(short[k]), float(score[k])


def exchanges(base: BaseProducts) -> Iterator[Trial]:
    """The readings of two rows exchanged: D is d = y_q - y_p in row p, -d in row q."""
    sheet, n = base.sheet, base.sheet.n
    pairs = np.stack(np.triu_indices(n, 1), axis=1)
    change = sheet.reading[pairs[:, ::-1]] - sheet.reading[pairs]

    def scores(base: BaseProducts, which: Index) -> Array:
        return base.gain(base.misfit(pairs[which], change[which]), len(pairs))

    for k, score in _shortlist(base, scores, len(pairs)):
        order = np.arange(n)
        order[pairs[k]] = order[pairs[k, ::-1]]
        p, q = (int(row) for row in sheet.row[pairs[k]])
        what = f"rows {p} and {q}: their readings are exchanged"
        fault = Fault("exchange", what, (p, q), score, f"--swap {p},{q}")
        mended = sheet.with_reading(sheet.reading[order])
        yield Trial(fault, mended, prior_of(len(pairs)))


@dataclass(frozen=True)
class _Orders:
    """Changes of the order: source (H, n) of each row's reading, the row that is left without
    one (H,) or -1, the reading that is left over (H,), first and last row, and direction."""

    source: Index
    lost: Index
    spare: Index
    first: Index
    last: Index
    late: NDArray[np.bool_]


def blocks(base: BaseProducts) -> Iterator[Trial]:
    """One row's reading moved to another place, or a block of readings one row late or early.

    A shift leaves one row without a reading (integrated out) and one reading over, which repeats
    its neighbour's unless it stands at an end of the sheet.
    """
    sheet = base.sheet
    tried = _orders(sheet) if sheet.ordered else None
    if tried is None:
        return
    for k, score in _shortlist(base, partial(_scores, tried), len(tried.lost)):
        yield _block(sheet, tried, k, score)


def _orders(sheet: Sheet) -> _Orders | None:
    """Every block of three or more neighbouring rows, moved in both directions and shifted."""
    n, run = sheet.n, sheet.runs()
    found = list[tuple[Index, int, int, int, int, bool]]()
    for a, b in combinations(range(n), 2):
        if b < a + 2 or run[a] != run[b] or not (n <= ANY_BLOCK or a == 0 or b == n - 1):
            continue
        for late in (True, False):
            source = np.arange(n)
            if late:  # the readings of a+1..b are those of a..b-1
                source[a:b] = np.arange(a + 1, b + 1)
            else:
                source[a + 1 : b + 1] = np.arange(a, b)
            lost, spare = (b, a) if late else (a, b)
            turned = source.copy()
            turned[lost] = spare
            found.append((turned, -1, 0, a, b, late))
            found.append((source, lost, spare, a, b, late))
    return _Orders(*(np.array(c) for c in zip(*found, strict=True))) if found else None


def _scores(tried: _Orders, base: BaseProducts, which: Index) -> Array:
    """(h,) nats of some changes of the order beyond the sheet as it stands."""
    reading, n = base.sheet.reading, base.sheet.n
    change = (reading[tried.source[which]] - reading).reshape(len(which), -1)
    lost = tried.lost[which]
    at = np.flatnonzero(lost >= 0)
    rows = 3 * lost[at, None] + np.arange(3)
    rss = np.empty((len(base.rss), len(which)))
    for k, (P, g) in enumerate(zip(base.P, base.g, strict=True)):
        h = change @ P
        rss[k] = base.rss[k] + 2.0 * change @ g + np.einsum("hi,hi->h", h, change)
        own = P.reshape(n, 3, n, 3)[lost[at], :, lost[at]]
        part = h[at[:, None], rows] + g[rows]
        rss[k, at] -= np.einsum("hi,hi->h", part, np.linalg.solve(own, part[..., None])[..., 0])
    rss[:, at] *= base.dof / max(base.dof - 3.0, 1.0)
    twin = np.where(tried.late[which], tried.first[which], tried.last[which])
    away = reading[tried.spare[which]] - reading[tried.source[which, twin]]
    stray = 2.0 * np.log1p(np.sum(away**2, axis=-1) / (2.0 * SPARE**2))  # multivariate Cauchy
    return base.gain(rss, len(tried.lost)) - np.where(lost >= 0, stray, 0.0)


def _block(sheet: Sheet, tried: _Orders, k: int, score: float) -> Trial:
    a, b = int(sheet.row[tried.first[k]]), int(sheet.row[tried.last[k]])
    late, lost = bool(tried.late[k]), int(tried.lost[k])
    kind: Kind
    mended = sheet.with_reading(sheet.reading[tried.source[k]])
    if lost < 0:
        at, to = (a, b) if late else (b, a)
        kind, line = "move", f"--move {at},{to}"
        what = f"row {at}: its reading belongs to row {to}, and those between one row nearer"
    else:
        mended = mended.take(np.setdiff1d(np.arange(sheet.n), lost))
        kind, line = "shift", f"--shift readings:{a}-{b}={-1 if late else 1}"
        what = f"rows {a} to {b}: their readings stand one row {'late' if late else 'early'}, "
        what += f"row {b if late else a} has none"
    fault = Fault(kind, what, tuple(range(a, b + 1)), score, line)
    return Trial(fault, mended, prior_of(len(tried.lost)))


@dataclass(frozen=True)
class _Slip:
    """row : from 0; words : what happened; value : (3,) what the row's cells should say, in the
    sheet's unit; reading : (3,) the same in mg; digits : two of them are exchanged"""

    row: int
    words: str
    value: Array
    reading: Array
    digits: bool = False


def cells(base: BaseProducts, written: Array) -> Iterator[Trial]:
    """One cell with the wrong sign, ten times too large or small, or with two digits exchanged; or
    two cells of a row exchanged.

    written : (n, 3) the readings as the sheet has them, for the line to paste
    """
    sheet = base.sheet
    whole = np.flatnonzero(~sheet.find_copies())
    tried = [s for row in whole for s in _slips(int(row), written[row], sheet.reading[row])]
    if not tried:
        return
    rows = np.array([[slip.row] for slip in tried])
    change = np.array([[slip.reading] for slip in tried]) - sheet.reading[rows]
    digits = np.array([slip.digits for slip in tried])
    # Cells of two digits exchanged are as many as all others, or more, and share their prior.
    count = 2.0 * np.where(digits, max(int(digits.sum()), 1), max(int((~digits).sum()), 1))
    score = base.gain(base.misfit(rows, change), 1.0) - np.log(count)
    for k in select_leading(score):
        slip = tried[k]
        number, old = int(sheet.row[slip.row]), written[slip.row]
        moved = zip("xyz", slip.value, old, strict=True)
        mended = tuple((axis, float(value)) for axis, value, own in moved if value != own)
        line = " ".join(f"--fix {number}:{axis}={value:.10g}" for axis, value in mended)
        what = f"row {number}: {slip.words}"
        fault = Fault("cell", what, (number,), float(score[k]), line, cells=mended)
        reading = sheet.reading.copy()
        reading[slip.row] = slip.reading
        prior = prior_of(1.0) - float(np.log(count[k]))
        yield Trial(fault, sheet.with_reading(reading), prior)


def _slips(row: int, written: Array, reading: Array) -> Iterator[_Slip]:
    """Every slip of one row."""
    unit = np.divide(reading, written, out=np.zeros(3), where=written != 0.0)
    for axis, name in enumerate("xyz"):
        own = float(written[axis])
        tried = [
            (f"{name} lost its sign", -own),
            (f"{name} is ten times too large", 0.1 * own),
            (f"{name} is ten times too small", 10.0 * own),
            *((f"two digits of {name} are exchanged", value) for value in transpositions(own)),
        ]
        for words, number in tried:
            value = written.copy()
            value[axis] = number
            yield _Slip(row, words, value, unit * value, digits="digits" in words)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        order = np.arange(3)
        order[[a, b]] = b, a
        words = f"{'xyz'[a]} and {'xyz'[b]} are exchanged"
        yield _Slip(row, words, written[order], reading[order])


def transpositions(value: float) -> list[float]:
    """The numbers of which two neighbouring digits, exchanged, give this one."""
    text = f"{abs(value):.{FIGURES}g}"
    if "e" in text:
        return []
    text = f"0{text}"  # a zero in front was not written
    at = [k for k, letter in enumerate(text) if letter.isdigit()]
    found = []
    for a, b in pairwise(at):
        if text[a] != text[b]:
            letters = list(text)
            letters[a], letters[b] = letters[b], letters[a]
            found.append(float(np.copysign(float("".join(letters)), value)))
    return found


def other_axes(base: BaseProducts) -> Iterator[Trial]:
    """Readings whose axes are exchanged or inverted from some row on, or up to it."""
    sheet = base.sheet
    if sheet.n < 2 * PART:
        return
    at = np.arange(PART, sheet.n - PART + 1)
    count = 2.0 * len(_AXES) * len(at)
    turned = np.stack([sheet.reading[:, order] * sign for order, sign in _AXES])
    few = base.at_few()
    if not select_leading(few.gain(_corners(few, turned)[:, :, at], count).ravel()).size:
        return
    score = base.gain(_corners(base, turned)[:, :, at], count)
    for k in select_leading(score.ravel()):
        which, start = divmod(int(k), len(at))
        fault, mended = _other_part(sheet, which, int(at[start]), float(score[which, start]))
        if np.abs(mended.reading - sheet.reading).max() > MOVED * sheet.gravity:
            yield Trial(fault, mended, prior_of(count))


def _corners(base: BaseProducts, z: Array) -> Array:
    """(G, Q, n + 1) RSS with the rows from k on read as z (Q, n, 3)."""
    y, n = base.sheet.reading, base.sheet.n
    found = np.empty((len(base.rss), len(z), n + 1))
    for point, whole in enumerate(base.P):
        P = whole.reshape(n, 3, n, 3).transpose(0, 2, 1, 3)
        to_y = np.einsum("ia,ijab->ijb", y, P)
        to_z = np.einsum("qia,ijab->qijb", z, P, optimize=True)
        own = np.einsum("ijb,jb->ij", to_y, y)
        both = np.einsum("ijb,qjb->qij", to_y, z)
        new = np.einsum("qijb,qjb->qij", to_z, z, optimize=True)
        found[point] = (
            _before(own)[None] + 2.0 * _across(both) + _before(new[:, ::-1, ::-1])[:, ::-1]
        )
    return found


def _before(table: Array) -> Array:
    """(..., n + 1) sums of the leading k by k corners of (..., n, n)."""
    sums = table.cumsum(axis=-1).cumsum(axis=-2)
    corner = np.diagonal(sums, axis1=-2, axis2=-1)
    return np.concatenate([np.zeros_like(corner[..., :1]), corner], axis=-1)


def _across(table: Array) -> Array:
    """(..., n + 1) sums over rows before k and columns from k on."""
    above = table.cumsum(axis=-2)
    right = above[..., ::-1].cumsum(axis=-1)[..., ::-1]
    inner = np.diagonal(right[..., :-1, 1:], axis1=-2, axis2=-1)
    none = np.zeros_like(table[..., 0, :1])
    return np.concatenate([none, inner, none], axis=-1)


def _other_part(sheet: Sheet, which: int, start: int, score: float) -> tuple[Fault, Sheet]:
    """Which of the two parts is wrong no likelihood says: the one whose mending lets the sensor
    stand straight, else the shorter one."""
    order, sign = _AXES[which]
    back = np.argsort(order)
    later, earlier = np.arange(start, sheet.n), np.arange(start)
    tried = []
    for rows, source, signs in ((later, order, sign), (earlier, back, sign[back])):
        reading = sheet.reading.copy()
        reading[rows] = reading[rows][:, source] * signs
        mended = sheet.with_reading(reading)
        axes = nearest_axes(mended)
        tried.append((axes is None or not axes.straight, rows, axes_text(source, signs), mended))
    _, rows, text, mended = min(tried, key=lambda one: (one[0], one[1].size))
    numbers = tuple(int(row) for row in sheet.row[rows])
    first, last = numbers[0], numbers[-1]
    what = f"rows {first} to {last}: their x, y, z are the others' {text}"
    return Fault("axes", what, numbers, score, f"--axes={first}-{last}:{text}"), mended
