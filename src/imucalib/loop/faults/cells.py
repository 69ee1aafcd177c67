"""Readings of a sheet that are not what was read there: a cell, rows in the wrong place, axes.

At each point of noise the misfit is yᵀPy, P = V⁻¹ without what the model takes. For readings that
differ by D it is exactly

    RSS' = RSS + 2 Dᵀg + DᵀPD,  g = Py

so that every change is judged without a fit: a sign, a decimal point or two digits of one cell, two
cells or rows exchanged, one moved, a block shifted. Axes that are exchanged or inverted in all rows
from k on are a signed permutation Q; with z = Q y,

    RSS(k, Q) = Σ_{i,j<k} y_i P_ij y_j + 2 Σ_{i<k≤j} y_i P_ij z_j + Σ_{i,j≥k} z_i P_ij z_j

is a sum over corners of three tables.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise, permutations, product

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.loop.faults.conventions import axes_text, nearest_axes
from imucalib.loop.faults.sheet import Fault, Hypothesis, Sheet
from imucalib.loop.posterior.gram import Grams, log_sum
from imucalib.loop.posterior.odds import OPEN, SLIPS, WRONG
from imucalib.loop.posterior.solution import Explored
from imucalib.units import MG

#: Rows that a part has at least: of a single one, its cells are asked.
_LEAST = 2
#: Of gravity, what the other axes must move one reading by: an axis that stands level all the while
#: reads a few mg, and a drift does as much.
_MOVED = 0.05
_AXES = tuple(
    (np.array(order), np.array(sign))
    for order in permutations(range(3))
    for sign in product((1.0, -1.0), repeat=3)
    if (order, sign) != ((0, 1, 2), (1.0, 1.0, 1.0))
)


def other_axes(base: Base) -> list[Hypothesis]:
    """Readings whose axes are exchanged or inverted from some row on, or up to it."""
    sheet = base.sheet
    if not sheet.ordered or sheet.n < 2 * _LEAST:
        return []
    at = np.arange(_LEAST, sheet.n - _LEAST + 1)
    count = 2.0 * len(_AXES) * len(at)
    turned = np.stack([sheet.reading[:, order] * sign for order, sign in _AXES])
    few = base.at(base.few)
    if not leading(few.gain(_corners(few, turned)[:, :, at], count).ravel()).size:
        return []
    score = base.gain(_corners(base, turned)[:, :, at], count)
    found = []
    for k in leading(score.ravel()):
        which, start = divmod(int(k), len(at))
        one = _turned(sheet, which, int(at[start]), float(score[which, start]))
        one = replace(one, prior=prior_of(count))
        if np.abs(one.repaired.reading - sheet.reading).max() > _MOVED * sheet.gravity:
            found.append(one)
    return found


def _corners(base: Base, z: Array) -> Array:
    """(G, Q, n + 1) RSS with the rows from k on read as z (Q, n, 3)."""
    y, n = base.sheet.reading, base.sheet.n
    found = np.empty((len(base.rss), len(z), n + 1))
    blocks, _ = by_rows(base)
    for point, P in enumerate(blocks):  # (n, n, 3, 3)
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


def _turned(sheet: Sheet, which: int, start: int, score: float) -> Hypothesis:
    """Which of the two parts is wrong no likelihood says: the one whose mending lets the sensor
    stand straight, else the shorter one."""
    order, sign = _AXES[which]
    back = np.argsort(order)
    parts = [
        (np.arange(start, sheet.n), order, sign),
        (np.arange(start), back, sign[back]),
    ]
    parts.sort(key=lambda part: len(part[0]))
    mended = [_read_so(sheet, *part) for part in parts]
    straight = [(axes := nearest_axes(one)) is not None and axes.straight for one in mended]
    best = straight.index(True) if True in straight else 0
    rows, order, sign = parts[best]
    text = axes_text(order, sign)
    first, last = int(sheet.row[rows[0]]), int(sheet.row[rows[-1]])
    what = f"rows {first} to {last}: their x, y, z are the others' {text}"
    touched = tuple(int(row) for row in sheet.row[rows])
    fault = Fault("axes", what, touched, score, f"--axes={first}-{last}:{text}")
    return Hypothesis(fault, mended[best])


def _read_so(sheet: Sheet, rows: Index, order: Index, sign: Array) -> Sheet:
    reading = sheet.reading.copy()
    reading[rows] = reading[rows][:, order] * sign
    return sheet.with_reading(reading)


#: Hypotheses about blocks that are looked at on the whole grid, after a few of its points.
_SHORT_LIST = 60
#: Rows up to which a block may end anywhere; beyond, it reaches to an end of the sheet.
_ANY_BLOCK = 64
#: Width (mg) of the Cauchy density with which the reading that a shift leaves over repeats its
#: neighbour, or a stray one its prediction: a reading of another position costs 20 nats.
_SPARE = 3.0


def exchanges(base: Base) -> list[Hypothesis]:
    """The readings of two rows exchanged: D is d = y_q - y_p in row p, -d in row q."""
    sheet, n = base.sheet, base.sheet.n
    p, q = np.triu_indices(n, 1)
    d = sheet.reading[q] - sheet.reading[p]
    P, g = by_rows(base)
    both = P[:, p, p] + P[:, q, q] - P[:, p, q] - P[:, q, p]
    rss = base.rss[:, None] + 2.0 * np.einsum("hi,Ghi->Gh", d, g[:, p] - g[:, q])
    rss += np.einsum("hi,Ghij,hj->Gh", d, both, d)
    score = base.gain(rss, len(p))
    found = []
    for k in leading(score):
        order = np.arange(n)
        order[[p[k], q[k]]] = order[[q[k], p[k]]]
        rows = (int(sheet.row[p[k]]), int(sheet.row[q[k]]))
        what = f"rows {rows[0]} and {rows[1]}: their readings are exchanged"
        fault = Fault("exchange", what, rows, float(score[k]), f"--swap {rows[0]},{rows[1]}")
        found.append(Hypothesis(fault, sheet.with_reading(sheet.reading[order]), prior_of(len(p))))
    return found


def _stray(away: Array) -> Array:
    """Nats that a reading (..., 3) mg away from where it should be costs, multivariate Cauchy."""
    return np.asarray(2.0 * np.log1p(np.sum(away**2, axis=-1) / (2.0 * _SPARE**2)))


@dataclass(frozen=True)
class _Blocks:
    """Changes of the order: source (H, n) of each row's reading, the row that is left without
    one (H,) or -1, the reading that is left over (H,) or -1, first and last row, and direction."""

    source: Index
    lost: Index
    spare: Index
    first: Index
    last: Index
    late: NDArray[np.bool_]


def blocks(base: Base) -> list[Hypothesis]:
    """One row's reading moved to another place, or a block of readings one row late or early.

    A shift leaves one row without a reading (integrated out) and one reading over, which repeats
    its neighbour's unless it stands at an end of the sheet.
    """
    sheet = base.sheet
    tried = _orders(sheet.n, sheet.beside()) if sheet.ordered else None
    if tried is None:
        return []
    every = np.arange(len(tried.lost))
    short = np.argsort(-_scores(base.at(base.few), tried, every))[:_SHORT_LIST]
    score = _scores(base, tried, short)
    return [_block(base, tried, int(short[k]), float(score[k])) for k in leading(score)]


def _scores(base: Base, tried: _Blocks, which: Index) -> Array:
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
    return base.gain(rss, len(tried.lost)) - np.where(lost >= 0, _stray(away), 0.0)


def _orders(n: int, beside: Index) -> _Blocks | None:
    """Every block of three or more neighbouring rows, moved in both directions and shifted."""
    gap = np.concatenate([[0], np.cumsum(1 - beside)])
    ends = [
        (a, b)
        for a in range(n)
        for b in range(a + 2, n)
        if gap[a] == gap[b] and (n <= _ANY_BLOCK or a == 0 or b == n - 1)
    ]
    found = []
    for a, b in ends:
        for late in (True, False):
            source = np.arange(n)
            if late:  # the readings of a+1..b are those of a..b-1
                source[a:b] = np.arange(a + 1, b + 1)
            else:
                source[a + 1 : b + 1] = np.arange(a, b)
            turned = source.copy()
            turned[b if late else a] = a if late else b
            found.append((turned, -1, 0, a, b, late))
            found.append((source, b if late else a, a if late else b, a, b, late))
    if not found:
        return None
    columns = [np.array(column) for column in zip(*found, strict=True)]
    return _Blocks(*columns)


def _block(base: Base, tried: _Blocks, k: int, score: float) -> Hypothesis:
    sheet, prior = base.sheet, prior_of(len(tried.lost))
    a, b = int(sheet.row[tried.first[k]]), int(sheet.row[tried.last[k]])
    rows = tuple(range(a, b + 1))
    reading = sheet.reading[tried.source[k]]
    late = bool(tried.late[k])
    if tried.lost[k] < 0:
        at, to = (a, b) if late else (b, a)
        what = f"row {at}: its reading belongs to row {to}, and those between one row nearer"
        fault = Fault("move", what, rows, score, f"--move {at},{to}")
        return Hypothesis(fault, sheet.with_reading(reading), prior)
    step, lost = (-1, b) if late else (1, a)
    what = (
        f"rows {a} to {b}: their readings stand one row {'late' if late else 'early'}, "
        f"row {lost} has none"
    )
    fault = Fault("shift", what, rows, score, f"--shift readings:{a}-{b}={step}")
    left = np.setdiff1d(np.arange(sheet.n), tried.lost[k])
    return Hypothesis(fault, sheet.with_reading(reading).take(left), prior)


def by_rows(base: Base) -> tuple[Array, Array]:
    """P as (G, n, n, 3, 3) and g as (G, n, 3)."""
    n = base.sheet.n
    P = base.P.reshape(-1, n, 3, n, 3).transpose(0, 1, 3, 2, 4)
    return P, base.g.reshape(-1, n, 3)


def leading(score: Array) -> Index:
    """Those that are worth being solved again, best first."""
    best = float(score.max(initial=-np.inf))
    if best <= -OPEN / 3.0:
        return np.zeros(0, np.intp)
    order = np.argsort(-score)[:8]
    return order[score[order] > max(-OPEN / 3.0, best - OPEN)]


_PAIRS = ((0, 1), (0, 2), (1, 2))
#: Significant figures of a cell of which two neighbours may have changed places.
_FIGURES = 10


@dataclass(frozen=True)
class _Slip:
    """row : from 0; words : what happened; value : (3,) what the row's cells should say, in the
    sheet's unit; reading : (3,) the same in mg; digits : two of them are exchanged"""

    row: int
    words: str
    value: Array
    reading: Array
    digits: bool = False


def cells(base: Base, si: Array) -> list[Hypothesis]:
    """One cell with the wrong sign, ten times too large or small, or with two digits exchanged; or
    two cells of a row exchanged.

    si : (n, 3) the readings as the sheet has them, for the line to paste
    """
    sheet = base.sheet
    copied = sheet.copied()
    tried = [
        slip
        for row in np.flatnonzero(~copied)
        for slip in _slips(int(row), si[row], sheet.reading[row])
    ]
    row = np.array([slip.row for slip in tried], np.intp)
    if not row.size:
        return []
    d = np.stack([slip.reading for slip in tried]) - sheet.reading[row]
    P, g = by_rows(base)
    own = P[:, np.arange(sheet.n), np.arange(sheet.n)]
    moved = np.einsum("Ghij,hj->Ghi", own[:, row], d)
    rss = base.rss[:, None] + np.einsum("hi,Ghi->Gh", d, 2.0 * g[:, row] + moved)
    digits = np.array([slip.digits for slip in tried])
    # Cells of two digits exchanged are as many as all others, or more, and share their prior.
    count = 2.0 * np.where(digits, max(int(digits.sum()), 1), max(int((~digits).sum()), 1))
    score = base.gain(rss, 1.0) - np.log(count)
    prior = prior_of(1.0) - np.log(count)
    told = [(_told(base, si, tried[k], float(score[k])), float(prior[k])) for k in leading(score)]
    return [replace(one, prior=p) for one, p in told]


def _slips(row: int, si: Array, reading: Array) -> list[_Slip]:
    """Every slip of one row."""
    found = []
    unit = np.divide(reading, si, out=np.zeros(3), where=si != 0.0)
    for axis, name in enumerate("xyz"):
        change = partial(_changed, si, axis)
        found.append((f"{name} lost its sign", change(-si[axis])))
        found.append((f"{name} is ten times too large", change(0.1 * si[axis])))
        found.append((f"{name} is ten times too small", change(10.0 * si[axis])))
    slips = [_Slip(row, words, value, unit * value) for words, value in found]
    for axis, name in enumerate("xyz"):
        for digits in transposed(float(si[axis])):
            value = _changed(si, axis, digits)
            words = f"two digits of {name} are exchanged"
            slips.append(_Slip(row, words, value, unit * value, digits=True))
    for a, b in _PAIRS:
        order = np.arange(3)
        order[[a, b]] = b, a
        words = f"{'xyz'[a]} and {'xyz'[b]} are exchanged"
        slips.append(_Slip(row, words, si[order], reading[order]))
    return slips


def _changed(si: Array, axis: int, value: float) -> Array:
    other = si.copy()
    other[axis] = value
    return other


def transposed(value: float) -> list[float]:
    """The numbers of which two neighbouring digits, exchanged, give this one."""
    text = f"{abs(value):.{_FIGURES}g}"
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


def _told(base: Base, si: Array, slip: _Slip, score: float) -> Hypothesis:
    number = int(base.sheet.row[slip.row])
    mended = tuple(
        (axis, float(value))
        for axis, value, old in zip("xyz", slip.value, si[slip.row], strict=True)
        if value != old
    )
    line = " ".join(f"--fix {number}:{axis}={value:.10g}" for axis, value in mended)
    changed = base.sheet.reading.copy()
    changed[slip.row] = slip.reading
    what = f"row {number}: {slip.words}"
    fault = Fault("cell", what, (number,), score, line, cells=mended)
    return Hypothesis(fault, base.sheet.with_reading(changed))


#: Noises on which many hypotheses are looked at first.
_FEW = 3


@dataclass(frozen=True)
class Base:
    """P : (G, 3n, 3n) at G noises; g : P y (G, 3n); rss : (G,); grams : where they come from
    response : (3, 3) what the sensor makes of a force, mg for mg"""

    sheet: Sheet
    P: Array
    g: Array
    rss: Array
    grams: Grams
    dof: float
    response: Array

    def each(self, rss: Array) -> Array:
        """Log likelihood and prior at every noise for sums of squares (G, ...)."""
        weight = self.grams.log_weight.reshape((-1,) + (1,) * (rss.ndim - 1))
        return np.asarray(weight + self.grams.log_noise(np.maximum(rss, 1e-9), self.dof))

    def best(self, rss: Array) -> Array:
        """(...) log likelihood over all noises."""
        return log_sum(self.each(rss))

    def gain(self, rss: Array, count: float) -> Array:
        """(...) nats beyond the sheet as it stands, less what one slip of `count` in its class pays
        for being one of them."""
        return np.asarray(self.best(rss) - float(self.best(self.rss)) + prior_of(count))

    @property
    def few(self) -> Index:
        """The likeliest noises."""
        return np.argsort(-self.each(self.rss))[:_FEW]

    def at(self, noises: Index) -> Base:
        """The same at some of the noises only."""
        return replace(
            self,
            P=self.P[noises],
            g=self.g[noises],
            rss=self.rss[noises],
            grams=self.grams.of(noises),
        )


def prior_of(count: float) -> float:
    """Log prior odds of one slip among `count` of its class."""
    return float(np.log(WRONG / SLIPS / count))


def base_of(found: Explored, sheet: Sheet, one: Grams) -> Base:
    """The base of a sheet of known angles; one : Grams beside the base model and a set, the
    readings' own numbers before y."""
    unit = found.base.at.unit / MG
    single = np.arange(-1 - unit.size, -1) + one.along.shape[1]
    rows = one.rows(single)
    return Base(
        sheet=sheet,
        P=rows[:, :, single] / np.outer(unit, unit),
        g=rows[:, :, -1] / unit,
        rss=one.power,
        grams=one,
        dof=found.posterior.dof,
        response=_response(found),
    )


def _response(found: Explored) -> Array:
    """(3, 3) slope of a reading by the force on the tool, about no force."""
    fit = found.base
    one = fit.observations.context.take(np.zeros(1, np.intp))
    return np.asarray(fit.model.predict(fit.theta, np.zeros((1, 1, 3)), one).d_truth[0, 0])
