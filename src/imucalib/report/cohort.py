"""The page of a cohort: a row a recording, those to look at first, and what all have left."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import PurePath
from typing import Any

import numpy as np

from imucalib.report.render.document import Plot, Series, Tone
from imucalib.report.render.html import SIGNS, WORDS
from imucalib.report.render.svg import render_svg
from imucalib.report.render.templates import fill

_RANK: dict[Tone, int] = {"bad": 0, "warning": 1, "ok": 2, "plain": 3}
#: Column of the table -> heading.
_NUMBERS = {
    "error_before": "before",
    "error_after": "after",
    "hours_worn": "worn (h)",
    "posture_runs": "postures",
    "enmo_before_mg": "ENMO before (mg)",
    "enmo_after_mg": "ENMO after (mg)",
}
_TONES: dict[str, Tone] = {"use": "ok", "care": "warning", "do not": "bad"}


def cohort_html(rows: Iterable[Mapping[str, Any]], title: str) -> str:
    """One self-contained HTML page of the rows that `cohort.entries.rows` makes; of each it keeps
    what it shows.

    Without a script the table is sorted: what is not to be used, what is with care, then by the
    error left, largest first.
    """
    shown = ("recording", "use", "why", "what_to_do", "error_unit", *_NUMBERS)
    table = [{name: row.get(name) for name in shown} for row in rows]
    units = sorted({str(row["error_unit"]) for row in table if row.get("error_unit")})
    unit = f" ({units[0]})" if len(units) == 1 else ""
    ordered = sorted(table, key=lambda row: (_RANK[_tone(row)], -(row.get("error_after") or 0.0)))
    good, doubted, bad = (sum(row["use"] == use for row in table) for use in _TONES)
    numbers = {k: name for k, name in _NUMBERS.items() if any(row.get(k) for row in table)}
    heads = [f"{name}{unit if 'error' in key else ''}" for key, name in numbers.items()]
    page = {
        "title": title,
        "verdict": f"{len(table)} recordings: {good} to use, {doubted} with care, {bad} not.",
        "tone": "bad" if bad == len(table) else "warning" if bad or doubted else "ok",
        "header": ("recording", "use", "why", *heads),
        "rows": [_row(row, len(units) > 1, numbers) for row in ordered],
        "plot": _plot(table, unit),
    }
    return fill("cohort.html.j2", page=page, signs=SIGNS, words=WORDS, svg=render_svg)


def _tone(row: Mapping[str, Any]) -> Tone:
    return _TONES[str(row["use"])]


def _row(row: Mapping[str, Any], mixed: bool, numbers: Iterable[str]) -> dict[str, Any]:
    """What the cells of one recording show.

    mixed : whether errors have several units, so that each says its own; numbers : of which columns
    """
    unit = str(row.get("error_unit") or "")
    return {
        "path": str(row["recording"]),
        "name": PurePath(str(row["recording"])).name,
        "tone": _tone(row),
        "use": row["use"],
        "numbers": [_shown(row.get(k), unit if mixed and "error" in k else "") for k in numbers],
        "why": _why(row),
    }


def _why(row: Mapping[str, Any]) -> str:
    """What is against a recording and, where that does not say so itself, what to do."""
    why, step = str(row["why"]), str(row.get("what_to_do") or "")
    return f"{why}. {step}" if why and step and step not in why else why


def _shown(value: Any, unit: str = "") -> str:
    if value is None:
        return ""
    return f"{value:{'.3g' if abs(value) < 999.5 else '.0f'}} {unit}".strip()


def _plot(table: Sequence[Mapping[str, Any]], unit: str) -> Plot | None:
    """Errors before and after, each in order; None where fewer than two are known."""
    series = []
    for name in ("before", "after"):
        found = sorted(float(row[f"error_{name}"]) for row in table if row.get(f"error_{name}"))
        rank = 100.0 * (np.arange(len(found)) + 0.5) / max(len(found), 1)
        series.append(Series(name, rank, np.array(found), "line"))
    if min(len(one.x) for one in series) < 2:
        return None
    caption = "On held-out data, each line in order: how many recordings are left with how much."
    label = f"error{unit}"
    share = "share of the recordings (%)"
    return Plot("What all have left", share, label, tuple(series), caption, log_y=True)
