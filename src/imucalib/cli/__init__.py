"""The command `imucal`: one file a command; each is imported only when it is called."""

from __future__ import annotations

import importlib
import os
import re
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from imucalib.cli.frame.failures import Failed, example_of, failure_of
from imucalib.errors import CRASH_EXIT_CODE, EXIT_CODES, ImucalError
from imucalib.question import paste

#: Commands in the order of the overview; others, by their names, stand behind them.
_ORDER = (
    "lab actigraph imu array design inspect noise check compare apply export convert batch collect "
    "fleet simulate effects validate"
)
_TOLD = re.compile(r"imucal (\w+): (.+)")
#: What people call what a command does.
_MEANT = {
    "lab": ("bench", "tumble", "sixface", "multiposition", "table"),
    "actigraph": ("worn", "wrist", "autocalibrate", "gravity"),
    "imu": ("gyro", "gyroscope"),
    "noise": ("allan", "avar", "adev", "variance"),
    "inspect": ("info", "show", "read", "describe", "open", "view", "print", "summary"),
    "check": ("verify", "test", "monitor"),
    "apply": ("correct", "fix", "run", "use"),
    "compare": ("diff",),
    "export": ("write", "save"),
    "design": ("plan", "positions", "recommend"),
}
#: What people call all of those that calibrate.
_CALIBRATE = ("calibrate", "calibration", "cal", "calib", "fit")
#: Words in the place of a command that are options.
_WORDS = {"help": "--help", "version": "--version"}


def _discover_commands() -> dict[str, tuple[str, str]]:
    """Command -> the module that holds it, and one line for the overview: a file of this folder
    begins with `imucal NAME: one line.` for `command`, and for each other function that is one."""
    found = dict.fromkeys(_ORDER.split(), ("", ""))
    for file in sorted(Path(__file__).parent.glob("*.py")):
        doc = file.read_text(encoding="utf-8").split('"""', 2)[1]
        found |= {name: (file.stem, says) for name, says in _TOLD.findall(doc)}
    return found


_FOUND = _discover_commands()
#: Command -> one line for the overview.
COMMANDS = {name: says for name, (_, says) in _FOUND.items()}


class LazyGroup(click.Group):
    """Knows its commands by name, and imports one when it is called."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if args and args[0] in _WORDS:  # as git, cargo and others take them
            args = [*args[1:], _WORDS[args[0]]]
        ctx.meta["imucal.arguments"] = tuple(args)  # the line that provenance keeps
        rest = super().parse_args(ctx, args)
        if not ctx.resilient_parsing:
            ctx.default_map = self._stated(args)
        return rest

    def _stated(self, args: Sequence[str]) -> dict[str, Any]:
        """What imucal.toml says of the command that was called."""
        from imucalib.cli.frame.bench_file import NAME, defaults, sections

        found = sections(Path.cwd())
        unknown = [name for name in found if name not in COMMANDS]
        if unknown:
            raise click.UsageError(f"{NAME}: no command '{unknown[0]}'")
        name = next((word for word in args if not word.startswith("-")), "")
        command = self.get_command(click.Context(self), name) if name in found else None
        return {name: defaults(command, found[name])} if command else {}

    def main(self, args: Sequence[str] | None = None, *others: Any, **options: Any) -> Any:
        """As click has it; a failure is told as JSON where JSON was asked for."""
        from imucalib.errors import ImucalError

        try:
            return super().main(args, *others, **options)
        except (ImucalError, click.ClickException, OSError) as error:
            given = list(sys.argv[1:] if args is None else args)
            if isinstance(error, ImucalError) and error.add:
                error.remedy += f", for example: {paste('imucal', *given, *error.add)}"
            if "--json" in given[: given.index("--") if "--" in given else None]:
                from imucalib.cli.frame.output import emit_json

                emit_json(Failed(failure_of(error)))
            raise

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        file = _FOUND[cmd_name][0]
        module = importlib.import_module(f"imucalib.cli.{file}")
        command: click.Command = getattr(module, "command" if cmd_name == file else cmd_name)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            if _is_place(args[0]):
                return "inspect", self.get_command(ctx, "inspect"), args
            ctx.fail(_no_command(args))
        return super().resolve_command(ctx, args)


def _is_place(word: str) -> bool:
    """Whether a word that is no command names a file, or looks like the name of one."""
    return os.path.exists(word) or bool(os.path.splitext(word)[1]) or os.sep in word


def calibrators() -> list[str]:
    """The commands that calibrate."""
    from imucalib.cli.frame.calibrating import is_calibrator

    root = click.Context(cli)
    every = ((name, cli.get_command(root, name)) for name in COMMANDS)
    return [name for name, command in every if command and is_calibrator(command)]


def _no_command(args: Sequence[str]) -> str:
    """What to type in the place of a command that is none."""
    import difflib

    word = args[0].lower()
    close = difflib.get_close_matches(word, [*_CALIBRATE, *COMMANDS, *_WORDS], 1)
    if close and close[0] in _CALIBRATE:
        kinds = "\n".join(f"  imucal {name:9}  {COMMANDS[name]}" for name in calibrators())
        return f"no command '{args[0]}'. These calibrate, by what was recorded:\n{kinds}"
    meant = next((name for name, words in _MEANT.items() if word in words), "")
    if meant or close:
        return f"no command '{args[0]}'. Did you mean '{meant or close[0]}'?"
    return f"no command '{args[0]}', and no such file. There are: {', '.join(COMMANDS)}."


def _version(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted and not ctx.resilient_parsing:
        from imucalib import __version__

        click.echo(f"imucal {__version__}")
        ctx.exit()


@click.command(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog=f"Exit codes: {', '.join(f'{code} {says}' for code, says in EXIT_CODES.items())}.",
)
@click.option(
    "-V",
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_version,
    help="Show the version and exit.",
)
def cli() -> None:
    """Calibrate inertial sensors from recorded logs, with honest uncertainty.

    Finds what its own model lacks, adds it, and proves the gain on data it did not fit.

    \b
    Example: imucal lab positions.csv -o out --gravity 9.8061
    """


def main() -> None:
    """Entry point: runs a command and turns every failure into its message and exit code."""
    # The matrices are small: a second BLAS thread costs more than it does, and changes last bits.
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    _prepare_streams()
    # Temporary files are removed on the way out, as after Ctrl-C.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    try:
        code = cli.main(prog_name="imucal", standalone_mode=False)
        sys.stdout.flush()
    except ImucalError as error:
        from imucalib.cli.frame.output import say

        say(f"error: {error}", err=True)
        code = error.exit_code
    except click.ClickException as error:
        error.show()
        if example := example_of(error):
            click.echo(f"For example: {example}", err=True)
        code = error.exit_code
    except click.Abort:
        click.echo("stopped", err=True)
        code = 130
    except (BrokenPipeError, SystemExit) as error:
        # Where nobody reads on, as in `imucal inspect x | head`, click ends with 1: here a limit.
        left = "PacifyFlushWrapper" in type(sys.stdout).__name__
        if not (left or isinstance(error, BrokenPipeError)):
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # nor is there anything left to say at exit
        code = 141  # as of a program that SIGPIPE ended
    except OSError as error:
        # A full disk or a missing permission while writing: outputs are whole or absent.
        click.echo(f"error: {error.filename or 'output'}: {error.strerror}", err=True)
        code = 3
    except Exception as error:  # a fault of this program: its report and exit 70, not a traceback
        code = _report_crash(error)
    sys.exit(code if isinstance(code, int) else 0)


def _prepare_streams() -> None:
    """Streams that take any text: closed ones lead nowhere, odd file names become "?"."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


def _report_crash(error: Exception) -> int:
    """Say in one line that this is a fault of the program, and where its traceback is."""
    import tempfile
    import traceback

    what = " ".join(f"{type(error).__name__}: {error}".split())[:200]
    try:
        handle, path = tempfile.mkstemp(prefix="imucal-crash-", suffix=".txt")
        with open(handle, "w", encoding="utf-8", errors="replace") as file:
            file.write("".join(traceback.format_exception(error)))
    except OSError:
        path = "nowhere: no place for it"
    from imucalib.cli.frame.output import say

    say(f"error: imucal failed ({what}); please report it with {path}", err=True)
    return CRASH_EXIT_CODE
