"""imucal simulate: recordings that never were, one file a calibrator, found by being here."""

from __future__ import annotations

import importlib
import pkgutil

import click


class Simulations(click.Group):
    """The files of this folder, each imported when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        names = {info.name for info in pkgutil.iter_modules(__path__)}
        return sorted(names - {"planting"})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.list_commands(ctx):
            return None
        command: click.Command = importlib.import_module(f"{__name__}.{cmd_name}").command
        return command


@click.command("simulate", cls=Simulations)
def command() -> None:
    """Make a table or a recording with planted effects, faults and noise, for any calibrator.

    What was planted is printed (--json for machines), and stands in no file: a calibrator must
    find it.

    \b
    Examples:
      imucal simulate lab bench.csv --plant inclination_zero=0.8 --slip 10:y
      imucal simulate actigraph day.h5 --plant quadratic=3,-3,4
      imucal simulate array log.h5 --plant gyro_delay=0.001 --fault gap@20:2
    """
