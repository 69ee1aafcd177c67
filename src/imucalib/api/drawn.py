"""A report's figures, drawn by matplotlib where that is installed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from imucalib.errors import UsageError
from imucalib.report.document import RESIDUALS, Document, Plot, Series

#: What a series is drawn with.
_STYLES: dict[str, dict[str, Any]] = {
    "points": {"linestyle": "", "marker": "."},
    "rings": {"linestyle": "", "marker": "o", "fillstyle": "none"},
    "bars": {"linestyle": "", "marker": "o"},
    "step": {"drawstyle": "steps-post"},
}


def plots_of(document: Document, which: str) -> tuple[Plot, ...]:
    """The plots whose title or section holds some words; of none, those before and after.

    Raises UsageError with the titles that there are.
    """
    every, wanted = document.plots, which.lower() or RESIDUALS.lower()
    found = tuple(p for title, p in every if wanted in f"{title} {p.title}".lower())
    if not found:
        titles = "; ".join(dict.fromkeys(p.title for _, p in every)) or "none"
        raise UsageError(f"no figure '{which or wanted}'", remedy=f"there are: {titles}")
    return found


def drawn(plots: Sequence[Plot], library: Any) -> Any:
    """A figure with one set of axes a plot. library : matplotlib.pyplot, or what draws as it"""
    figure, axes = library.subplots(
        len(plots), 1, figsize=(7.0, 3.2 * len(plots)), squeeze=False, layout="constrained"
    )
    for plot, ax in zip(plots, axes[:, 0], strict=True):
        for series in plot.series:
            _add(ax, series)
        ax.set(title=plot.title, xlabel=plot.x_label, ylabel=plot.y_label)
        if plot.log_y:
            ax.set_yscale("log")
        if plot.equal:
            ax.set_aspect("equal")
        if plot.bare:
            ax.set(xticks=[], yticks=[])
        ax.legend()
    return figure


def _add(ax: Any, series: Series) -> None:
    if series.mark == "band" and series.low is not None and series.high is not None:
        ax.fill_between(series.x, series.low, series.high, alpha=0.2, label=series.label)
        return
    ax.plot(series.x, series.y, label=series.label, **_STYLES.get(series.mark, {}))
    if series.low is not None and series.high is not None:
        ax.vlines(series.x, series.low, series.high, linewidth=1.0)


def matplotlib() -> Any:
    """Its pyplot. Raises UsageError where it is not installed."""
    try:
        return __import__("matplotlib.pyplot", fromlist=["pyplot"])
    except ImportError:
        raise UsageError("matplotlib is not installed", remedy="pip install matplotlib") from None
