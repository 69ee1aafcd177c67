"""`imucal design --imu`: which turns to take by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from imucalib.cli.output import color, emit_json, width


def by_hand(calibration: Path | None, rests: int | None, options: dict[str, Any]) -> int:
    """Print a plan of turns, or what to add to those of a calibration; the exit code."""
    from imucalib.calibration.file import read
    from imucalib.calibrators.imu.plan import hand_plan, turns_to_add
    from imucalib.report.imu.plan import hand_plan_dict, hand_plan_document
    from imucalib.report.render.text import render_text

    for name in ("separate", "output", "temperatures", "between_sessions"):
        if options[name] is not None:
            raise click.UsageError(f"--{name.replace('_', '-')} does not go with --imu")
    plan = hand_plan(rests or 0) if calibration is None else turns_to_add(read(calibration))
    if options["as_json"]:
        emit_json(hand_plan_dict(plan))
    elif not options["quiet"]:
        document = hand_plan_document(plan)
        click.echo(render_text(document, width(), color=color(), full=options["full"]), nl=False)
    return 4 if plan.open_gains else 0
