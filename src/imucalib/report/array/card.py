"""What an array's calibration is good to: positions, gyros and accelerometers in motion."""

from __future__ import annotations

import numpy as np

from imucalib.calibrators.array.run import ArrayRun
from imucalib.report.card import card_of, error_worth
from imucalib.report.document import Card, Text, Worth
from imucalib.units import DEG


def array_card(run: ArrayRun, observability: tuple[Text, ...]) -> Card:
    """The card of an array; observability : what the motion did not determine, in words."""
    sd = 1e3 * run.final.sd[1:]
    k, axis = np.unravel_index(int(np.argmax(sd)), sd.shape)
    positions = Worth(
        "positions",
        f"± {1.96 * np.median(sd):.2g} mm",
        f"95 %, the median of {sd.size} coordinates; worst {run.board.imus[1 + int(k)]} "
        f"{'xyz'[int(axis)]}, ± {1.96 * sd.max():.2g} mm; size and frame included",
    )
    total = run.total
    shape = 1e3 * np.sqrt(np.maximum(np.diag(total.shape), 0.0))
    apart = Worth(
        "their shape alone",
        f"± {1.96 * np.median(shape):.2g} mm",
        f"95 %, the median; one error for all is in the size, ± {196.0 * total.size_sd:.2g} %, and "
        f"in the frame, ± {1.96 * float(total.frame_sd.max()) / DEG:.2g} deg",
    )
    names = ("accelerometers in motion", "gyros in motion")
    errors = zip(run.outcome.errors, names, strict=False)
    worths = (positions, apart, *(error_worth(e, n, "motion") for e, n in errors))
    return card_of(run.outcome, worths, *(t.text for t in observability if t.tone == "warning"))
