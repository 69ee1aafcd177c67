"""The command `imucal`: one file a command; each is imported only when it is called."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence
from typing import Any

import click

#: Command -> one line for the overview; the module of the same name holds `command`.
COMMANDS = {
    "lab": "Calibrate a tool's accelerometer on a bench with known angles, or by gravity alone.",
    "actigraph": "Calibrate a worn sensor from days of recording, by gravity at rest.",
    "array": "Find the positions of the accelerometers of an inertial sensor array.",
    "design": "Judge a set of positions, and say which added ones help most.",
    "inspect": "Say what a recording holds and how it would be read.",
    "apply": "Correct a recording with a calibration.",
    "export": "Write a calibration's coefficients for another program.",
    "convert": "Rewrite a recording in another format.",
    "batch": "Calibrate a cohort, one recording a task.",
    "collect": "Make one table of a cohort's entries.",
    "simulate": "Make a bench table or recording with planted effects.",
    "effects": "List the catalogue of effects.",
    "validate": "Check a calibration file.",
}


class LazyGroup(click.Group):
    """Knows its commands by name, and imports one when it is called."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        ctx.meta["imucal.arguments"] = tuple(args)  # the line that provenance keeps
        return super().parse_args(ctx, args)

    def main(self, args: Sequence[str] | None = None, *others: Any, **options: Any) -> Any:
        """As click has it; a failure is told as JSON where JSON was asked for."""
        from imucalib.errors import ImucalError

        try:
            return super().main(args, *others, **options)
        except (ImucalError, click.ClickException, OSError) as error:
            given = list(sys.argv[1:] if args is None else args)
            if "--json" in given[: given.index("--") if "--" in given else None]:
                from imucalib.cli.output import emit_json

                emit_json({"error": told(error)})
            raise

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"imucalib.cli.{cmd_name}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            import difflib

            near = difflib.get_close_matches(args[0], COMMANDS, 1)
            hint = f" Did you mean '{near[0]}'?" if near else f" There are: {', '.join(COMMANDS)}."
            ctx.fail(f"no command '{args[0]}'.{hint}")
        return super().resolve_command(ctx, args)


def _version(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted and not ctx.resilient_parsing:
        from imucalib import __version__

        click.echo(f"imucal {__version__}")
        ctx.exit()


@click.command(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Exit codes: 0 calibrated, 1 a limit is broken, 2 usage, 3 unreadable input, "
    "4 not determined by the data, 5 residual unexplained, 6 not converged.",
)
@click.option("--version", is_flag=True, is_eager=True, expose_value=False, callback=_version,
              help="Show the version and exit.")  # fmt: skip
def cli() -> None:
    """Calibrate inertial sensors from recorded logs, with honest uncertainty.

    Finds what its own model lacks, adds it, and proves the gain on data it did not fit.

    \b
    Example: imucal lab positions.csv -o out --gravity 9.8061
    """


def told(error: Exception) -> dict[str, Any]:
    """A failure for machines: message, where, remedy and exit code."""
    from imucalib.errors import ImucalError, UnreadableInput

    if isinstance(error, ImucalError):
        said = error.what, error.where, error.remedy, error.exit_code
    elif isinstance(error, click.ClickException):
        said = error.format_message(), "", "", error.exit_code
    else:
        name = str(getattr(error, "filename", None) or "")
        said = str(getattr(error, "strerror", error)), name, "", UnreadableInput.exit_code
    return dict(zip(("message", "where", "remedy", "exit_code"), said, strict=True))


def main() -> None:
    """Entry point: runs a command and turns every failure into its message and exit code."""
    from imucalib.errors import ImucalError

    # The matrices are small: a second BLAS thread costs more than it does, and changes last bits.
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="replace")
    try:
        code = cli.main(standalone_mode=False)
    except ImucalError as error:
        click.echo(f"error: {error}", err=True)
        code = error.exit_code
    except click.ClickException as error:
        error.show()
        code = error.exit_code
    except click.Abort:
        click.echo("stopped", err=True)
        code = 130
    except OSError as error:
        # A full disk or a missing permission while writing: outputs are whole or absent.
        click.echo(f"error: {error.filename or ''}: {error.strerror}", err=True)
        code = 3
    sys.exit(code if isinstance(code, int) else 0)
