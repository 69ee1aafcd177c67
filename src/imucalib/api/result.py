"""What a calibration returns: the run with its report, files and tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any, Literal

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.findings import Gain
from imucalib.calibration.outcome import Run, Status
from imucalib.effects.forms import in_words
from imucalib.errors import UsageError
from imucalib.report.files import Report, write_report
from imucalib.report.render.document import RESIDUALS, Document, Plot, Series

Rows = Literal["parameters", "errors", "candidates"]
#: What a series is drawn with.
_STYLES: dict[str, dict[str, Any]] = {
    "points": {"linestyle": "", "marker": "."},
    "rings": {"linestyle": "", "marker": "o", "fillstyle": "none"},
}


@dataclass(frozen=True, repr=False)
class Result:
    """A finished calibration.

    run : everything that the calibrator knows, by its own types; document : its report
    """

    run: Run
    document: Document

    @property
    def calibration(self) -> Calibration:
        """What corrects readings: `calibration.apply(reading)`."""
        return self.run.calibration

    @property
    def status(self) -> Status:
        """ "ok", "marginal", "weak" or "failed"; see `exit_code` for why."""
        return self.run.outcome.status

    @property
    def exit_code(self) -> int:
        """That of the command: 0 fine, 1 a limit is broken, 4 undetermined, 5 unexplained."""
        return self.run.outcome.exit_code

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that the search added."""
        found = self.run.outcome.findings
        return tuple(step.effect for step in found.steps) if found else ()

    @property
    def gain(self) -> Gain | None:
        """Errors before and after on data that took no part in any choice, with the interval of
        the gain; None where nothing was searched for."""
        found = self.run.outcome.findings
        return found.gain if found else None

    @cached_property
    def _report(self) -> Report:
        return Report(self.run, self.document)

    @property
    def report(self) -> Mapping[str, Any]:
        """The content of report.json."""
        return self._report.content

    def save(self, folder: Path | str) -> tuple[Path, ...]:
        """Write calibration.yaml, report.json and report.html, all or none; returns their paths."""
        return write_report(self._report, Path(folder))

    def to_dataframe(self, rows: Rows = "parameters") -> Any:
        """A table of pandas, or of polars where pandas is not installed.

        rows : "parameters" (value, sd, unit), "errors" (raw, base, final, held out) or
        "candidates" (what the search tried, with its evidence). Raises UsageError where neither
        library is installed.
        """
        table = _rows(self.report, rows)
        for name in ("pandas", "polars"):
            try:
                library: Any = __import__(name)
            except ImportError:
                continue
            return library.DataFrame(table)
        raise UsageError("no library for tables", remedy="pip install pandas, or polars")

    def plot(self, which: str = "") -> Any:
        """Figures of the report, drawn by matplotlib: those whose title or section holds the words,
        of none the residual before and after. Raises UsageError where it is not installed, or
        where no figure is called so."""
        plots = plots_of(self.document, which)
        try:
            library = __import__("matplotlib.pyplot", fromlist=["pyplot"])
        except ImportError:
            remedy = "pip install matplotlib"
            raise UsageError("matplotlib is not installed", remedy=remedy) from None
        return _draw(plots, library)

    def __repr__(self) -> str:
        """One line: what was calibrated, verdict, error on held-out data, what was found."""
        outcome, error = self.run.outcome, self.run.outcome.error
        final = error.final if math.isnan(error.held_out.final) else error.held_out.final
        names = ", ".join(map(in_words, self.effects))
        return (
            f"<imucalib {outcome.calibrator} of {outcome.provenance.input}: {self.status}, "
            f"{error.metric} {final:.3g} {error.unit}{f'; found: {names}' if names else ''}>"
        )

    def _repr_html_(self) -> str:
        """The report's first fold, for a notebook."""
        from imucalib.report.render.html import render_html

        fold = replace(self.document, sections=(), footer=(), certificate=None)
        return (
            f'<iframe srcdoc="{escape(render_html(fold))}" title="Calibration report" '
            'style="width:100%;height:36rem;border:0"></iframe>'
        )

    def __str__(self) -> str:
        """One page, as the command prints it."""
        from imucalib.report.render.text import render_text

        return render_text(self.document, 80, color=False)


def _rows(report: Mapping[str, Any], rows: Rows) -> list[dict[str, Any]]:
    loop = report["loop"]
    if rows == "parameters":
        return list(report["parameters"])
    if rows == "candidates":
        return list(loop["candidates"])
    if rows != "errors":
        raise UsageError(f"no table '{rows}'", remedy="parameters, errors or candidates")
    return [
        {k: v for k, v in error.items() if k != "held_out"}
        | {f"held_out_{k}": v for k, v in error["held_out"].items()}
        for error in loop["errors"]
    ]


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


def _draw(plots: Sequence[Plot], library: Any) -> Any:
    """A figure with one set of axes a plot. library : matplotlib.pyplot, or what draws as it"""
    figure, axes = library.subplots(
        len(plots), 1, figsize=(7.0, 3.2 * len(plots)), squeeze=False, layout="constrained"
    )
    for plot, ax in zip(plots, axes[:, 0], strict=True):
        for series in plot.series:
            _add_series(ax, series)
        ax.set(title=plot.title, xlabel=plot.x_label, ylabel=plot.y_label)
        if plot.log_y:
            ax.set_yscale("log")
        if plot.equal:
            ax.set_aspect("equal")
        if plot.bare:
            ax.set(xticks=[], yticks=[])
        ax.legend()
    return figure


def _add_series(ax: Any, series: Series) -> None:
    if series.mark == "band" and series.low is not None and series.high is not None:
        ax.fill_between(series.x, series.low, series.high, alpha=0.2, label=series.label)
        return
    ax.plot(series.x, series.y, label=series.label, **_STYLES.get(series.mark, {}))
    if series.low is not None and series.high is not None:
        ax.vlines(series.x, series.low, series.high, linewidth=1.0)
