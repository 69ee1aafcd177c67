"""Numbers as a metrologist prints them: as many digits as the standard deviation has to say."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping


def digits_for(sd: float) -> int:
    """Decimals that show two significant digits of a standard deviation."""
    if not math.isfinite(sd) or sd <= 0.0:
        return 4
    return max(0, 1 - math.floor(math.log10(sd)))


def number(value: float, places: int = 2, absent: str = "-") -> str:
    """With so many decimals; a word where there is none."""
    return f"{value:.{places}f}" if math.isfinite(value) else absent


def size_with_unit(value: float, unit: str) -> str:
    """ "0.36 mg": two significant digits and the unit, of which "1" is none."""
    return f"{value:.2g} {unit.removeprefix('1')}".rstrip()


def format_components(values: Iterable[float], places: int = 2) -> str:
    """ "+0.10  -0.99  +0.00": components of a vector."""
    return "  ".join(f"{value:+.{places}f}" for value in values)


def format_with_sd(value: float, sd: float) -> tuple[str, str]:
    """Value and standard deviation as text with matching digits."""
    places = digits_for(sd)
    if places > 9:
        return f"{value:.3g}", f"{sd:.2g}"
    return f"{value:.{places}f}", f"{sd:.{places}f}"


def plus_minus(value: float, sd: float, unit: str = "") -> str:
    """ "1.96 ± 0.16 deg" """
    shown, spread = format_with_sd(value, sd)
    return f"{shown} ± {spread}" + (f" {unit}" if unit and unit != "1" else "")


def probability(p: float, draws: int) -> str:
    """A p-value; one of Monte Carlo that no simulated data set reached is shown as a bound."""
    if not draws:
        return f"{p:.2g}"
    return f"< {1.0 / draws:.1g}" if p <= 1.5 / (draws + 1) else f"{p:.2g}"


def per_cent(share: float) -> str:
    """A probability as a person reads it: never 0 or 100 %."""
    if share > 0.99:
        return "> 99 %"
    return "< 1 %" if share < 0.01 else f"{100.0 * share:.0f} %"


def list_likely(shares: Mapping[str, float], least: float = 0.1) -> str:
    """Names with their probabilities, the likeliest first, down to the least."""
    likely = sorted((p, name) for name, p in shares.items() if p >= least)
    return ", ".join(f"{name} {per_cent(p)}" for p, name in reversed(likely))


def two_digits(value: float) -> str:
    """Two significant digits, and all before the point: "0.83", "6.5", "419"."""
    return f"{value:.0f}" if abs(value) >= 99.5 else f"{value:.2g}"
