"""Whether a form with a formula explains as much as the name that a search is about to take.

Every form of `effects/shape` that the driver of the name can have is scanned at the same time: an
axis' own input, or the temperature. The evidence of a form is the mean over the values that were
tried, which pays for having looked.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import Fit
from imucalib.effects import known
from imucalib.loop.candidates import effect_candidates
from imucalib.loop.shapes import forms_of
from imucalib.loop.thresholds import MARGIN, STRONG
from imucalib.loop.wander.bank import Bank, Mask
from imucalib.loop.wander.likelihood import Terms
from imucalib.loop.wander.scores import SIZES, Entry, Scored, beside, joined

#: Not the step, whose readings have no inverse, and not the saw-tooth, which has 256 members and is
#: what a converter's curve is for.
_TRIED = ("sine", "power", "kink", "saturation", "soft_saturation", "exponential")
FAMILY = "shape"
#: Share of a form's columns beside those of a name below which the form is the name itself.
_ITSELF = 1e-6


def driver_of(entry: Entry) -> str:
    """What the forms of a name bend and against what, as their names have it; empty for none."""
    if entry.kind in ("shape", "posture"):
        return "response:xyz"
    return "bias:temperature" if entry.kind == "temperature" else ""


def form_columns(small: Fit, driver: str) -> list[tuple[str, Array]]:
    """Names and columns (n, 3 or 6), in units of the reading's sigma."""
    what, against = driver.split(":")
    names = [name for kind in _TRIED for name in forms_of(small, kind, what, against)]
    effects = [effect for effect in map(known, dict.fromkeys(names)) if effect is not None]
    found, _ = effect_candidates(small, effects)
    return [(c.name, c.columns) for c in found]


@dataclass(frozen=True)
class Rival:
    """A form beside a name; bank : with its columns; score : by the mean over the form's scan."""

    bank: Bank
    score: Scored


def rival_form(
    bank: Bank, terms: Terms, keep: Mask, named: Scored, forms: Sequence[tuple[str, Array]]
) -> Rival | None:
    """The form that explains most, where forms do about as well as the name or better.

    A form of the same covariate has the same cause, and must lead. One of the response has another:
    a certain name leads all of these together, for nothing says which of them it would be.
    """
    own = bank.columns[:, named.entry.columns]
    others = [(name, columns) for name, columns in forms if not _inside(own, columns)]
    if not others:
        return None
    blocks = [own, *(columns for _, columns in others)]
    gains = beside(bank, terms, keep, named.walk, blocks, SIZES)
    best = gains.max(axis=1)
    kinds = defaultdict[str, list[int]](list)
    for k, (name, _) in enumerate(others):
        kinds[name.split(":")[2]].append(k + 1)
    mean = {kind: float(np.log(np.mean(np.exp(best[k] - best[k].max()))) + best[k].max())
            for kind, k in kinds.items()}  # fmt: skip
    kind = max(mean, key=lambda kind: mean[kind])
    together = float(np.logaddexp.reduce(list(mean.values())))
    near = together > best[0] - MARGIN if named.entry.kind == "shape" else mean[kind] > best[0]
    if not near:
        return None
    at = max(kinds[kind], key=lambda k: best[k])
    entry = replace(named.entry, family=FAMILY)
    evidence = named.evidence + mean[kind] - float(best[0])
    size = SIZES[int(np.argmax(gains[at]))]
    score = replace(named, entry=entry, size=size, evidence=evidence)
    return Rival(*joined(bank, score, *others[at - 1]))


def leads(form: Scored, named: Scored) -> bool:
    """Whether a form explains more than a name by a margin, so that it may take its place.

    Postures sample a response hundreds of times, a day a temperature few: what else moves in that
    day bends it by three nats now and then. A curve has no name to lose.
    """
    margin = 0.0 if named.entry.free else MARGIN if named.entry.kind == "shape" else STRONG
    return form.evidence > named.evidence + margin


def _inside(own: Array, columns: Array) -> bool:
    q = np.linalg.qr(own)[0]
    left = columns - q @ (q.T @ columns)
    return bool(np.linalg.norm(left) <= _ITSELF * np.linalg.norm(columns))
