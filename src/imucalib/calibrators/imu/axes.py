"""Whether the gyroscope's axes are those of the accelerometer: gravity says, turn by turn.

Every signed permutation is tried. Of a rotation P, R(Pω) = P R(ω) P', so that two integrations a
turn, of ω and of -ω, serve all 48.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.estimators.carried import attitudes, between
from imucalib.estimators.turns import TurnLog, moved_by
from imucalib.units import DEG

#: Turns that are carried, and rad by which plain gains carry gravity past where it is.
_TURNS, _OFF = 12, 2.0 * DEG
#: Nats by which another mapping has to lead: one of 48, a thousand to one.
_LEAD = float(np.log(48.0 * 1000.0))


def demand_axes(log: TurnLog, where: str, written: Array) -> None:
    """Raise UnreadableInput, with the option that undoes it, where the gyroscope's axes are others
    than the accelerometer's. written : (3, 3) signed permutation that was stated already"""
    turns = sorted(log.turns, key=lambda turn: -turn.lasting)[:_TURNS]
    turned = []
    for turn in turns:
        seen, _ = moved_by(log, log.rate, turn)
        turned.append([attitudes(turn.t, sign * seen)[-1] for sign in (1.0, -1.0)])
    up = log.force / np.linalg.norm(log.force, axis=1)[:, None]
    before, after = (up[[turn.rest + k for turn in turns]] for k in (0, 1))
    whole = np.array(turned)
    found = []
    for P in _mappings():
        sign = round(float(np.linalg.det(P)))
        pure = sign * P
        carried = np.einsum(
            "ji,njk,nk->ni", pure.T, whole[:, 0 if sign > 0 else 1].swapaxes(1, 2), before @ pure
        )
        off = between(carried, after)
        found.append((float(-1.5 * np.log1p((off / _OFF) ** 2).sum()), float(np.median(off)), P))
    as_read = next(f for f in found if np.array_equal(f[2], np.eye(3)))
    best = max(found, key=lambda f: f[0])
    if best[0] - as_read[0] < _LEAD:
        return
    line = ",".join(_axis(row) for row in best[2] @ written)
    mirrored = (
        "; one of the two sensors is mirrored, and gravity does not say which"
        if np.linalg.det(best[2]) < 0.0
        else ""
    )
    raise UnreadableInput(
        f"over {len(turns)} turns the gyroscope carries gravity {as_read[1] / DEG:.0f} deg past "
        f"where it is, and {best[1] / DEG:.1f} deg where its axes are {line}{mirrored}",
        where=where,
        remedy=f"add --gyro-axes={line}",
    )


def _mappings() -> list[Array]:
    return [
        np.eye(3)[list(order)] * np.array(signs)[:, None]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]


def _axis(row: Array) -> str:
    k = int(np.argmax(np.abs(row)))
    return ("-" if row[k] < 0.0 else "") + "xyz"[k]
