"""Help of one page: options that few need wait for --help-all."""

from __future__ import annotations

import click

#: Lines of 80 columns.
PAGE = 60
#: Heading -> options, by parameter name, that a help longer than a page leaves to --help-all.
RARE = {
    "Reading a recording": (
        "mapping", "acc", "gyro", "temperature", "time", "lsb", "gyro_unit", "gyro_lsb",
        "time_unit", "rate", "axis_map", "preset", "acc_offset", "skip", "decimal", "max_chunk",
        "allow_external", "delimiter", "shortest_rest", "where", "temperature_unit", "time_format",
    ),
    "Angles and rows of a table": (
        "gravity_sign", "z_axis", "inclination_zero", "toolface_zero_axis", "toolface_sense",
        "toolface_offset", "angle_unit", "swap_angles", "keep_angles", "axes", "swaps", "moves",
        "shifts",
    ),
    "Fit and search": (
        "train", "model", "objective", "sigma", "as_published", "arithmetic", "loop", "curves",
        "seed", "height", "effects_file", "fleet", "without",
    ),
    "Posterior of an array": (
        "as_drawn", "sampler", "samples", "motion_prior", "det_exponent", "acc_sigma",
        "gyro_covariance", "chains", "ess", "iterations", "save_draws", "checkpoint", "accept_mm",
        "accept_mg", "accept_dps",
    ),
    "Limits": (
        "max_inclination_error", "max_toolface_error", "max_norm_error", "max_worst_error",
        "max_gyro_error", "max_position_sd", "fail_on",
    ),
}  # fmt: skip
_HEADING = {name: heading for heading, names in RARE.items() for name in names}
_ASKED = "imucal.help_all"

Records = list[tuple[str, str]]


def _show_all(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted and not ctx.resilient_parsing:
        ctx.meta[_ASKED] = True
        click.echo(ctx.get_help(), color=ctx.color)
        ctx.exit()


_HELP_ALL = click.Option(
    ["--help-all"], is_flag=True, is_eager=True, expose_value=False, callback=_show_all,
    help="Show every option and exit.",
)  # fmt: skip


class PagedCommand(click.Command):
    """A command whose help, where it is longer than a page, leaves rare options to --help-all."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        return [*super().get_params(ctx), _HELP_ALL]

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        if self._fits(ctx):
            _write(formatter, self._in_order(ctx))
            return
        usual, rare = self._records(ctx)
        _write(formatter, usual)
        if ctx.meta.get(_ASKED):
            for heading, records in rare.items():
                _write(formatter, records, heading)
        else:
            formatter.write_paragraph()
            count = sum(map(len, rare.values()))
            what = ", ".join(heading.lower() for heading in rare)
            formatter.write_text(f"{ctx.command_path} --help-all: {count} more options ({what}).")

    def _records(self, ctx: click.Context) -> tuple[Records, dict[str, Records]]:
        """Usual options, and the others by heading."""
        usual: Records = []
        rare: dict[str, Records] = {}
        for param in self.get_params(ctx):
            if record := _record(param, ctx):
                heading = _HEADING.get(str(param.name))
                (rare.setdefault(heading, []) if heading else usual).append(record)
        return usual, {heading: rare[heading] for heading in RARE if heading in rare}

    def _in_order(self, ctx: click.Context) -> Records:
        """All options in one list; there is nothing that --help-all would add."""
        params = (p for p in self.get_params(ctx) if p is not _HELP_ALL)
        return [record for p in params if (record := _record(p, ctx))]

    def _fits(self, ctx: click.Context) -> bool:
        """Whether the whole help is a page, whatever the terminal's width."""
        page = click.HelpFormatter(width=78)
        self.format_usage(ctx, page)
        self.format_help_text(ctx, page)
        _write(page, self._in_order(ctx))
        self.format_epilog(ctx, page)
        return page.getvalue().count("\n") <= PAGE


def _record(param: click.Parameter, ctx: click.Context) -> tuple[str, str] | None:
    return param.get_help_record(ctx) if isinstance(param, click.Option) else None


def _write(formatter: click.HelpFormatter, records: Records, heading: str = "Options") -> None:
    with formatter.section(heading):
        formatter.write_dl(records)
