"""What a file holds, field by field: for errors, and for what was left unread."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.question import paste

_SHOWN = 12
#: Median norms that gravity has in the units in use, within this factor.
_GRAVITY, _WITHIN = (9.80665, 1.0, 1000.0), 1.15


@dataclass(frozen=True)
class Content:
    """One topic, column, dataset or field.

    address : what the options --acc, --gyro and --time take
    kind : type, encoding, shape, as the format says it
    count : messages or rows; rate : Hz, NaN when unknown
    norm : median norm of a 3-vector in the file's unit, else NaN; median : of a single number
    why : why it could not be read, or empty
    """

    address: str
    kind: str
    count: int
    rate: float = math.nan
    norm: float = math.nan
    median: float = math.nan
    why: str = ""

    def __str__(self) -> str:
        parts = [f"{self.count} x" if self.count else "", self.kind]
        parts += [f"{self.rate:.4g} Hz" if math.isfinite(self.rate) else ""]
        parts += [f"median norm {self.norm:.5g}" if math.isfinite(self.norm) else ""]
        parts += [f"median {self.median:.6g}" if math.isfinite(self.median) else "", self.why]
        return f"{self.address}: {', '.join(filter(None, parts))}"

    @property
    def like_gravity(self) -> bool:
        """Whether the norm is that of gravity in m/s², g or mg."""
        return any(g / _WITHIN <= self.norm <= g * _WITHIN for g in _GRAVITY)


def norm_of(values: Array) -> float:
    """Median norm of (n, 3) values, the incomplete ones left out; NaN when none is left."""
    norms = np.linalg.norm(values[np.isfinite(values).all(axis=1)], axis=1)
    return float(np.median(norms)) if norms.size else math.nan


def _shown(contents: Sequence[Content]) -> list[str]:
    """The first in words, and how many more there are."""
    more = len(contents) - _SHOWN
    return [*map(str, contents[:_SHOWN]), *([f"and {more} more"] if more > 0 else [])]


def listing(contents: Sequence[Content]) -> str:
    """One indented line each, for an error's text."""
    return "".join(f"\n  {words}" for words in _shown(contents))


def suggestion(contents: Sequence[Content]) -> str:
    """The field whose norm is that of gravity, as an option; empty when there is none or two."""
    fitting = [c.address for c in contents if c.like_gravity]
    if len(fitting) != 1:
        return ""
    return f"; the norm of gravity is in: {paste('--acc', fitting[0])}"


def describe_unread(contents: Sequence[Content]) -> tuple[str, ...]:
    """The sentence on what a file holds beside what is read; none where that is all of it."""
    return (f"not read: {'; '.join(_shown(contents))}",) if contents else ()
