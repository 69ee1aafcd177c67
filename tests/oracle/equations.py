"""The printed equations of docs/effects.md, parsed and evaluated. Imports nothing of the code.

Accelerations are in g, rates in deg/s, angles in deg, as the parameters' printed units are; a
product is written by a blank, as in the page.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PAGE = Path(__file__).parents[2] / "docs" / "effects.md"
#: Of printed units, whatever they are per, in g, deg, s and m.
_SIZES = {"mg": 1e-3, "mm": 1e-3, "ms": 1e-3, "%": 1e-2, "deg": 1.0, "1": 1.0, "": 1.0}
_FUNCTIONS: dict[str, Callable[[Array], Array]] = {
    "sin": lambda v: np.sin(np.deg2rad(v)), "cos": lambda v: np.cos(np.deg2rad(v)),
    "exp": np.exp, "sign": np.sign, "abs": np.abs,
}  # fmt: skip
_TOKEN = re.compile(r"\s*(\d+\.?\d*|[A-Za-zα-ωΑ-Ω]\w*'?|\*\*|[-+*/()\[\]>Σ])")


@dataclass(frozen=True)
class Entry:
    """One effect as the page prints it. parameters : name -> unit; typical, most : their
    sizes, and those beyond which they are not believed."""

    name: str
    equation: str
    parameters: Mapping[str, str]
    typical: tuple[float, ...] = ()
    most: tuple[float, ...] = ()


def size_of(unit: str) -> float:
    """Of a printed unit. Raises KeyError for one that is not known."""
    return _SIZES[re.split("[ /]", unit)[0]]


def page(path: Path = PAGE) -> dict[str, Entry]:
    """Every effect of the catalogue."""
    out = {}
    for part in path.read_text(encoding="utf-8").split("\n## ")[1:]:
        name = part.split("\n", 1)[0].strip()
        equation = re.search(r"^`(.*)`$", part, re.M)
        listed = re.search(r"^(`[\w{},]+` .* to .*)$", part, re.M)
        if equation is None or listed is None:
            continue
        number = r"([-+.\de]+|inf)"
        size = rf"`(\w*)\{{?([\w,]*)\}}?` {number} to {number} ?([^;:]*)"
        found = [
            (head + tail, float(typical), float(most), unit.strip())
            for head, tails, typical, most, unit in re.findall(size, listed[1])
            for tail in tails.split(",")
        ]
        units = {n: unit for n, _, _, unit in found}
        typical, most = (tuple(row[k] for row in found) for k in (1, 2))
        out[name] = Entry(name, equation[1], units, typical, most)
    return out


def evaluated(entry: Entry, theta: Array, known: Mapping[str, Array]) -> Array:
    """The left side of an equation, (n,) or (n, 3) where it is printed axis by axis.

    known : (n, 3) vectors and (n,) numbers by the names of the page
    """
    text = _plain(entry.equation)
    left, right = text.split("=", 1)
    symbols = _symbols(right, known)
    stems = list(dict.fromkeys(_stem(n) for n in entry.parameters))
    if len(symbols) != len(stems):
        raise ValueError(f"{entry.name}: symbols {symbols} for parameters {stems}")
    units = np.array([size_of(u) for u in entry.parameters.values()])
    values = dict(zip(entry.parameters, theta * units, strict=True))

    def look(name: str, i: str, j: str) -> Array:
        stem, _, index = name.partition("_")
        axes = index.replace("i", i).replace("j", j) if set(index) <= {"i", "j"} else ""
        if name in known:
            return known[name]
        if stem in known and axes:
            return known[stem][:, "xyz".index(axes)]
        own = stems[symbols.index(name)]
        return np.asarray(values[f"{own}_{axes}" if axes else own])

    others = "j ≠ i" in entry.equation
    if left.strip().endswith("_i"):
        each = [_Parser(right, look, i, others=others).value() for i in "xyz"]
        return np.stack(each, axis=-1)
    return _Parser(right, look, "", others=others).value()


def _stem(name: str) -> str:
    return re.sub(r"_[xyz]{1,2}$", "", name)


def _plain(equation: str) -> str:
    """Without what is said beside the formula, powers and bars as operators."""
    text = re.split(r",\s+(?:j ≠|order from|φ =)", equation)[0]
    for power, digit in zip("²³⁴⁵⁶", "23456", strict=True):
        text = text.replace(power, f"**{digit}")
    text = text.replace("sign(x_i - x_i(previous position))", "side_i")
    text = text.replace("x_i(previous position)", "previous_i")
    text = re.sub(r"\|([^|]*)\|", r"abs(\1)", text)
    text = re.sub(r" ?°C| deg/s|(?<=\d) deg|_dial", "", text)
    return text.replace("[sweep > first]", "later")


def _symbols(right: str, known: Mapping[str, Array]) -> list[str]:
    """What stands for parameters, in order."""
    names = re.findall(r"(?<!\w)[A-Za-zα-ωΑ-Ω]\w*", re.sub(r"Σ_j", " ", right))
    free = [n for n in names if n not in known and n.partition("_")[0] not in known]
    return list(dict.fromkeys(n for n in free if n not in _FUNCTIONS))


class _Parser:
    """Recursive descent over + -, products by a blank, / and **; Σ_j runs over all axes, or over
    the others where the page says j ≠ i."""

    def __init__(
        self, text: str, look: Callable[[str, str, str], Array], axis: str, *, others: bool
    ) -> None:
        self.tokens = _TOKEN.findall(text.replace("Σ_j", "Σ"))
        self.look, self.axis, self.other, self.at = look, axis, "", 0
        self.summed = [j for j in "xyz" if not (others and j == axis)]

    def value(self) -> Array:
        found = self._sum()
        if self.at != len(self.tokens):
            raise ValueError(f"'{self.tokens[self.at]}' was not expected")
        return found

    def _next(self) -> str:
        return self.tokens[self.at] if self.at < len(self.tokens) else ""

    def _take(self) -> str:
        self.at += 1
        return self.tokens[self.at - 1]

    def _sum(self) -> Array:
        total = np.float64(0.0) if self._next() == "-" else self._product()
        while self._next() in ("+", "-"):
            sign = 1.0 if self._take() == "+" else -1.0
            total = total + sign * self._product()
        return total

    def _product(self) -> Array:
        if self._next() == "Σ":
            return self._over_j()
        total = self._power()
        while (token := self._next()) and token not in "+-)":
            if token == "/":
                self._take()
                total = total / self._power()
            else:
                total = total * self._power()
        return total

    def _over_j(self) -> Array:
        self._take()
        start, total = self.at, np.float64(0.0)
        for other in self.summed:
            self.at, self.other = start, other
            total = total + self._product()
        return np.asarray(total)

    def _power(self) -> Array:
        base = self._atom()
        if self._next() == "**":
            self._take()
            return base ** float(self._take())
        return base

    def _atom(self) -> Array:
        token = self._take()
        if token == "(":
            inner = self._sum()
            if self._take() != ")":
                raise ValueError("a bracket is not closed")
            return inner
        if token[0].isdigit():
            return np.float64(token)
        if token in _FUNCTIONS:
            return _FUNCTIONS[token](self._argument())
        return np.asarray(self.look(token, self.axis, self.other))

    def _argument(self) -> Array:
        """In brackets, or "2t", "i": a number and the name behind it."""
        if self._next() == "(":
            return self._atom()
        first = self._atom()
        number = self.tokens[self.at - 1][0].isdigit()
        return first * self._atom() if number else first
