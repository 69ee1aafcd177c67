"""What to record next: the candidates that are worth most to a question, whatever it asks.

A question says what each candidate is worth beside a plan: nats that its answer is expected to gain
(Lindley 1956), or how far it tells one explanation from another. Candidates are benches' positions,
rests, temperatures, turns.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.odds import ROUNDS

#: Numbers of candidates that a plan has, and the worth (c,) of one more of each.
Plan = tuple[int, ...]
Worth = Callable[[Plan], Array]
#: Gains below these are rounding: of one exchange, and of a round of them.
_GAIN, _ROUND = 1e-6, 1e-3


def grow(plan: Plan, worth: Worth) -> Plan:
    """A plan with one candidate more, then each exchanged while that helps."""
    each = worth(plan)
    chosen, now = [*plan, int(np.argmax(each))], float(each.max())
    for _ in range(ROUNDS):
        before = now
        for place in range(len(chosen)):
            each = worth(tuple(chosen[:place] + chosen[place + 1 :]))
            if float(each.max()) > now + _GAIN * abs(now) + 1e-12:
                chosen[place], now = int(np.argmax(each)), float(each.max())
        if now <= before + _ROUND * abs(before):
            break
    return tuple(chosen)


def nats(information: Array) -> Array:
    """(...) ½ log det of information matrices (..., p, p); -inf where one is singular."""
    sign, value = np.linalg.slogdet(information)
    return np.asarray(np.where(sign > 0, 0.5 * value, -np.inf))
