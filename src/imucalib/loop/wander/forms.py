"""Whether a form with a formula explains more than the name that a search is about to take.

Every form of `effects/shape` that an axis' own input can have is scanned at the same time. The
evidence of a form is the mean over the values that were tried, which pays for having looked.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import Fit
from imucalib.effects import known
from imucalib.loop.candidates import effect_candidates
from imucalib.loop.shapes import forms_of
from imucalib.loop.thresholds import MARGIN
from imucalib.loop.wander.bank import Bank, Mask
from imucalib.loop.wander.likelihood import Terms
from imucalib.loop.wander.scores import SIZES, Scored, beside, joined

#: Not the step, whose readings have no inverse, and not the saw-tooth, which has 256 members and is
#: what a converter's curve is for.
_TRIED = ("sine", "power", "kink", "saturation", "soft_saturation", "exponential")
FAMILY = "shape"


def form_columns(small: Fit) -> list[tuple[str, Array]]:
    """Names and columns (n, 3 or 6), in units of the reading's sigma."""
    names = [name for kind in _TRIED for name in forms_of(small, kind, "response", "xyz")]
    effects = [effect for effect in map(known, dict.fromkeys(names)) if effect is not None]
    found, _ = effect_candidates(small, effects)
    return [(c.name, c.columns) for c in found]


def outdone(
    bank: Bank, terms: Terms, keep: Mask, named: Scored, forms: Sequence[tuple[str, Array]]
) -> tuple[Bank, Scored] | None:
    """The form that explains more than a name by a margin, and a bank with its columns."""
    if not forms:
        return None
    blocks = [bank.columns[:, named.entry.columns], *(columns for _, columns in forms)]
    gains = beside(bank, terms, keep, named.walk, blocks, SIZES)
    best = gains.max(axis=1)
    kinds = defaultdict[str, list[int]](list)
    for k, (name, _) in enumerate(forms):
        kinds[name.split(":")[2]].append(k + 1)
    mean = {kind: float(np.log(np.mean(np.exp(best[k] - best[k].max()))) + best[k].max())
            for kind, k in kinds.items()}  # fmt: skip
    kind = max(mean, key=lambda kind: mean[kind])
    if mean[kind] <= best[0] + MARGIN:
        return None
    at = max(kinds[kind], key=lambda k: best[k])
    entry = replace(named.entry, family=FAMILY)
    evidence = named.evidence + mean[kind] - float(best[0])
    size = SIZES[int(np.argmax(gains[at]))]
    return joined(bank, replace(named, entry=entry, size=size, evidence=evidence), *forms[at - 1])
