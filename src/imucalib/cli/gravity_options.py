"""Options that say how large gravity is: shared by every calibrator."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])

_OPTIONS = (
    click.option("--gravity", type=float, help="Local gravity, m/s²; default: standard gravity."),
    click.option("--latitude", type=float, help="Latitude in degrees, for normal gravity."),
    click.option(
        "--height",
        type=float,
        default=0.0,
        help="Height above the ellipsoid in m, with --latitude.",
    ),
)


def gravity_options(command: Command) -> Command:
    """Add the options; `gravity_of` turns their values into m/s²."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def gravity_of(options: Mapping[str, Any]) -> tuple[float, str]:
    """Local gravity (m/s²) and where it comes from; raises click's usage errors."""
    from imucalib.units import STANDARD_GRAVITY, local_gravity

    if options["gravity"] is not None and options["latitude"] is not None:
        raise click.UsageError("--gravity and --latitude exclude each other")
    if options["gravity"] is not None:
        if not 9.7 < options["gravity"] < 9.9:
            raise click.BadParameter(
                "local gravity is between 9.7 and 9.9 m/s²", param_hint="--gravity"
            )
        return options["gravity"], "as given"
    if options["latitude"] is not None:
        value = local_gravity(options["latitude"], options["height"])
        return (
            value,
            f"normal gravity at latitude {options['latitude']:g}, height {options['height']:g} m",
        )
    return STANDARD_GRAVITY, "standard gravity; --gravity or --latitude gives the local value"
