"""One mistyped angle: the value that the sheet should have, from what the other rows predict.

The other rows give the coefficients β of [design, beside] with covariance s²C (three rows leave the
normal equations by a down-date); row k at the value v, with a setting of its own, is then

    S(v) = I + r_i² n_i n_i' + r_t² n_t n_t' + F(v) C F(v)',   q = (y_k - Fβ)' S⁻¹ (y_k - Fβ)
    log p(v) = -1/2 ln|S| - 3/2 ln RSS_k - ν/2 ln(1 + q/RSS_k)

on every whole degree of the dial. A value within a degree of the sheet's is no typo, and the
sheet's own value with a setting of its own (a row that was set again) is a rival.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.references import unit_vector
from imucalib.loop.faults.found import ENOUGH, Fault, Hypothesis
from imucalib.loop.faults.noise_grid import Base, beside_rows, design_rows
from imucalib.loop.faults.sheet import Sheet, slopes

#: A typo is at least this far (deg) from what the sheet has.
_NEAREST = 1.0
#: Points of noise that are kept for each row, by the other rows' likelihood.
_POINTS = 3
#: Steps to which dials are set, deg, and the share of a column that must be multiples of one.
_STEPS = (90.0, 45.0, 30.0, 22.5, 20.0, 15.0, 10.0, 5.0, 2.5, 2.0, 1.0, 0.5, 0.1, 0.01)
_ON_STEP = 0.9


@dataclass(frozen=True)
class _Others:
    """What the rows other than one say, at some points of noise (m,).

    beta : (m, p); C : (m, p, p) their covariance over s²; rss : (m,); each : log likelihood (m,)
    """

    beta: Array
    C: Array
    rss: Array
    each: Array
    r: Array

    @property
    def most(self) -> float:
        """Log likelihood of the whole sheet that no value of the row exceeds: q = 0, |S| = 1."""
        return float((self.each - 1.5 * np.log(self.rss)).max())


def angles(base: Base, unit: tuple[float, float] = (1.0, 1.0)) -> list[Hypothesis]:
    """Every row's inclination and tool-face read anew at every degree of the dial.

    unit : what one degree is in the sheet's columns of inclination and tool-face (π/180 for rad)
    """
    found = []
    others = _others(base)
    for row in np.flatnonzero(~base.sheet.copied()):
        for column in (0, 1):
            one = _typed(base, others[row], int(row), column, unit[column])
            if one is not None:
                found.append(one)
    return found


def _typed(base: Base, others: _Others, row: int, column: int, unit: float) -> Hypothesis | None:
    sheet = base.sheet
    own = float((sheet.inclination, sheet.tool_face)[column][row])
    dial = dial_of(column, (sheet.inclination, sheet.tool_face)[column])
    paid = np.log(len(dial)) + np.log(2.0 * sheet.n)
    if others.most - base.as_it_stands - paid <= ENOUGH:
        return None  # not even a value that fits without any misfit
    off = apart(dial, own, column)
    p = _density(base, others, row, column, np.append(dial, own))
    as_set = max(float(p[-1]), base.as_it_stands)
    best = int(np.argmax(np.where(off >= _NEAREST, p[:-1], -np.inf)))
    if p[best] - as_set - paid <= ENOUGH:
        return None  # a row that was set again, at the sheet's value, says as much
    value, sd, top = _refined(base, others, row, column, float(dial[best]))
    if apart(np.array([value]), own, column)[0] < _NEAREST:
        return None
    score = top - base.as_it_stands - paid
    shown = rounded(value, sd, np.delete((sheet.inclination, sheet.tool_face)[column], row))
    if apart(np.array([shown]), own, column)[0] < _NEAREST:
        shown = round(value, 1)  # the dial's step would lead back to what the sheet has
    name = ("inclination", "tool_face")[column]
    number = int(sheet.row[row])
    what = (
        f"row {number}: {name.replace('_', '-')} is {own:g} on the sheet where the reading says "
        f"{value:.2f} ± {sd:.2g} deg"
    )
    line = f"--fix {number}:{name}={shown * unit:.10g}"
    repaired = _with_angle(base, row, column, shown)
    return Hypothesis(Fault("angle", what, (number,), float(score), line), repaired)


def _with_angle(base: Base, row: int, column: int, value: float) -> Sheet:
    name = ("inclination", "tool_face")[column]
    sheet = base.sheet
    dial = getattr(sheet, name).copy()
    dial[row] = value
    groups = getattr(sheet, f"{name}_setting")
    if sheet.ordered:
        groups = np.concatenate([[0], np.cumsum(np.diff(dial) != 0.0)]).astype(np.intp)
    return replace(sheet, **{name: dial, f"{name}_setting": groups})


def dial_of(column: int, set_to: Array) -> Array:
    """Whole degrees that the dial shows: a turn of tool-face, 270 degrees of inclination."""
    if column:
        low = -180.0 if set_to.min() < 0.0 else 0.0
        return np.arange(low, low + 360.0)
    return np.arange(-90.0, 91.0) if set_to.max() <= 95.0 else np.arange(-90.0, 181.0)


def apart(value: Array, own: float, column: int) -> Array:
    away = np.abs(value - own)
    return np.abs(np.mod(away + 180.0, 360.0) - 180.0) if column else away


def _others(base: Base) -> list[_Others]:
    """The down-date for every row, at the points of noise that the other rows like best."""
    sheet, terms, grid = base.sheet, base.terms, base.grid
    weight = np.repeat(1.0 / sheet.sigma, 3)
    Z = weight[:, None] * np.column_stack([terms.design, terms.beside])
    y = weight * sheet.reading.ravel()
    i, t = weight[:, None] * terms.inclination, weight[:, None] * terms.tool_face
    V0, which = _settings_only(grid.inclination, grid.tool_face, i @ i.T, t @ t.T)
    W = np.linalg.inv(V0)
    U, v = W @ Z, W @ y
    H, r, yy = Z.T @ U, v @ Z, v @ y
    logdet = np.linalg.slogdet(V0)[1]
    share = np.maximum(grid.share, 1e-6) ** -2.0
    prior = np.zeros((len(grid.share), Z.shape[1]))
    prior[:, 12:] = share[:, None]
    lam = np.einsum("gp,pq->gpq", prior, np.eye(Z.shape[1]))
    found = []
    for row in range(sheet.n):
        part = slice(3 * row, 3 * row + 3)
        own = W[:, part, part]
        u, w = U[:, part], v[:, part]
        su = np.linalg.solve(own, u)
        sw = np.linalg.solve(own, w[..., None])[..., 0]
        Hk = (H - np.swapaxes(u, 1, 2) @ su)[which] + lam
        rk = (r - np.einsum("gip,gi->gp", u, sw))[which]
        beta = np.linalg.solve(Hk, rk[..., None])[..., 0]
        rss = np.maximum((yy - np.einsum("gi,gi->g", w, sw))[which] - (rk * beta).sum(1), 1e-12)
        det = logdet + np.linalg.slogdet(own)[1]
        c = -0.5 * (det[which] + np.linalg.slogdet(Hk)[1] - np.log(prior[:, 12:]).sum(1))
        nu = base.dof - 3.0
        each = c - 0.5 * nu * np.log(rss) + grid.prior(np.sqrt(rss / nu))
        top = np.argsort(-each)[:_POINTS]
        found.append(
            _Others(
                beta[top], np.linalg.inv(Hk[top]), rss[top], each[top],
                np.column_stack([grid.inclination[top], grid.tool_face[top]]),
            )
        )  # fmt: skip
    return found


def _settings_only(i: Array, t: Array, ii: Array, tt: Array) -> tuple[Array, Index]:
    """V without what is beside, once for each pair of (r_i, r_t), and which pair a point has."""
    pairs, which = np.unique(np.column_stack([i, t]), axis=0, return_inverse=True)
    V = np.eye(len(ii)) + (pairs[:, 0] ** 2)[:, None, None] * ii
    return V + (pairs[:, 1] ** 2)[:, None, None] * tt, which.ravel()


def _predicted(
    base: Base, others: _Others, row: int, column: int, dial: Array
) -> tuple[Array, Array, Array]:
    """Residual (m, d, 3), its covariance over s² (m, d, 3, 3), and slope (m, d, 3) mg/deg."""
    sheet = base.sheet
    both = [np.full(len(dial), sheet.inclination[row]), np.full(len(dial), sheet.tool_face[row])]
    both[column] = dial
    i, t = sheet.inside(both[0], both[1])
    truth = sheet.gravity * unit_vector(i, t)
    turn = base.terms.turn
    F = np.concatenate([design_rows(truth), beside_rows(sheet.gravity, i, t, turn)], axis=2)
    F = F / sheet.sigma[row]
    rest = sheet.reading[row] / sheet.sigma[row] - np.einsum("dip,mp->mdi", F, others.beta)
    S = np.einsum("dip,mpq,djq->mdij", F, others.C, F, optimize=True) + np.eye(3)
    along = [a @ turn.T / sheet.sigma[row] for a in slopes(sheet.gravity, i, t)]
    for k in (0, 1):
        S = S + (others.r[:, k] ** 2)[:, None, None, None] * (
            along[k][:, :, None] * along[k][:, None]
        )
    return rest, S, np.broadcast_to(along[column], rest.shape)


def _density(base: Base, others: _Others, row: int, column: int, dial: Array) -> Array:
    """Log likelihood of the whole sheet with the row at each value of the dial, (d,)."""
    rest, S, _ = _predicted(base, others, row, column, dial)
    q = np.einsum("mdi,mdi->md", rest, np.linalg.solve(S, rest[..., None])[..., 0])
    rss = others.rss[:, None]
    p = -0.5 * np.linalg.slogdet(S)[1] - 1.5 * np.log(rss) - 0.5 * base.dof * np.log1p(q / rss)
    return np.asarray((others.each[:, None] + p).max(axis=0))


def _refined(
    base: Base, others: _Others, row: int, column: int, value: float
) -> tuple[float, float, float]:
    """The value between the whole degrees, its sd (deg) and its log likelihood."""
    sd = np.inf
    for _ in range(4):
        at = np.array([value])
        rest, S, slope = _predicted(base, others, row, column, at)
        best = int(np.argmax([_density(base, _point(others, m), row, column, at)[0]
                              for m in range(len(others.rss))]))  # fmt: skip
        along, cov = slope[best, 0], S[best, 0]
        # What the setting itself scatters is part of S, so it is part of the sd too.
        bent = np.linalg.solve(cov, along)
        sign = _sense(base, row, column)
        step = float(bent @ rest[best, 0]) / float(bent @ along) * sign
        sd = float(np.sqrt(others.rss[best] / max(base.dof - 3.0, 1.0) / (bent @ along)))
        value += float(np.clip(step, -1.0, 1.0))
    return value, sd, float(_density(base, others, row, column, np.array([value]))[0])


def _point(others: _Others, m: int) -> _Others:
    one = slice(m, m + 1)
    return _Others(
        others.beta[one], others.C[one], others.rss[one], others.each[one], others.r[one]
    )


def _sense(base: Base, row: int, column: int) -> float:
    """+1 where the inner angle grows with the dial, else -1."""
    sheet = base.sheet
    i, t = sheet.inclination[row : row + 1], sheet.tool_face[row : row + 1]
    moved = sheet.inside(i + (1 - column), t + column)[column] - sheet.inside(i, t)[column]
    return float(np.sign(moved[0]))


def rounded(value: float, sd: float, set_to: Array) -> float:
    """A value on the steps to which the column is set; finer steps where neither three sd nor a
    fifth of the step (2 deg at most: what a dial may be off) reach one."""
    for step in _STEPS:
        on = np.abs(set_to / step - np.round(set_to / step)) < 1e-6
        near = round(value / step) * step
        if on.mean() >= _ON_STEP and abs(near - value) <= max(3.0 * sd, min(step / 5.0, 2.0)):
            return float(round(near, 6)) + 0.0  # no -0
    return float(round(value, 1 if sd < 1.0 else 0))
