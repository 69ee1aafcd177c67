"""Numbers as a metrologist prints them: as many digits as the standard deviation has to say."""

from __future__ import annotations

import math


def digits_for(sd: float) -> int:
    """Decimals that show two significant digits of a standard deviation."""
    if not math.isfinite(sd) or sd <= 0.0:
        return 4
    return max(0, 1 - math.floor(math.log10(sd)))


def with_sd(value: float, sd: float) -> tuple[str, str]:
    """Value and standard deviation as text with matching digits."""
    places = digits_for(sd)
    if places > 9:
        return f"{value:.3g}", f"{sd:.2g}"
    return f"{value:.{places}f}", f"{sd:.{places}f}"


def plus_minus(value: float, sd: float, unit: str = "") -> str:
    """ "1.96 ± 0.16 deg" """
    shown, spread = with_sd(value, sd)
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


def spread(values: tuple[float, float], places: int = 2) -> str:
    """Largest and rms value: "0.84 / 0.36"."""
    return f"{values[0]:.{places}f} / {values[1]:.{places}f}"


def two_digits(value: float) -> str:
    """Two significant digits, and all before the point: "0.83", "6.5", "419"."""
    return f"{value:.0f}" if abs(value) >= 99.5 else f"{value:.2g}"
