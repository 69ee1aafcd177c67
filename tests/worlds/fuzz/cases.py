"""One damaged file: made from a seed and a number, read, judged.

Outcomes: `right` (every sample as written, none lost, or the rest of a file that states no
length), `told` (refused, or what is left is right and the loss is told), `wrong, told` (samples
that were not written so, under a new note or gap), `silent`, `traceback`, `crash` (the
interpreter itself), `hang`, `memory`.
"""

from __future__ import annotations

import random
import re
import signal
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np

from imucalib import readers
from imucalib.errors import ImucalError
from imucalib.readers.fields.joining import join
from imucalib.recording.recording import Recording
from worlds.fuzz import calibrations
from worlds.fuzz.damage import damaged
from worlds.fuzz.files import Kind, Made, kinds
from worlds.fuzz.truth import compare

OUTCOMES = ("right", "told", "wrong, told", "silent", "traceback", "crash", "hang",
            "memory")  # fmt: skip
SECONDS = 20  # that a file of less than a megabyte may take
_NAMES = re.compile(r"^(Axivity|ActiGraph|GENEActiv) |^\S+ topic ")
_VARIANTS = 4  # files of each format; the damage differs from case to case


@dataclass(frozen=True)
class Verdict:
    """kind : the format's name; detail : what was done to the file, and what came of it"""

    number: int
    kind: str
    checked: str
    outcome: str
    detail: str


class TooLong(BaseException):
    """The case took more than its time; no reader may swallow it."""


class Fuzzer:
    """Cases by their number; files are written below `folder`."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder, self._seed = folder, seed
        self._kinds = kinds()
        self._made: dict[tuple[str, int], tuple[Made, frozenset[str]]] = {}

    def case(self, number: int) -> Verdict:
        """Damage a file, read it and judge what comes."""
        names = [*self._kinds, calibrations.NAME]
        name = names[number % len(names)]
        rng = random.Random(f"{self._seed} {number}")
        if name == calibrations.NAME:
            path = self._folder / calibrations.NAME
            done = calibrations.put(path, rng)
            try:
                with limited(SECONDS):
                    different = calibrations.different(path)
                outcome, detail = ("silent" if different else "right"), str(different)
            except BaseException as error:
                outcome, detail = failure(error)
            return Verdict(number, name, "all", outcome, f"{done}: {detail}")
        kind = self._kinds[name]
        made, notes = self._undamaged(name, kind, rng.randrange(_VARIANTS))
        data, done = damaged(made.data, rng, made.edges)
        path = self._folder / f"case{kind.suffix}"
        path.write_bytes(made.pack(data))
        outcome, detail = _judged(path, made, notes, kind, rng.random() < 0.3)
        return Verdict(number, name, kind.checked, outcome, f"{done}: {detail}")

    def _undamaged(self, name: str, kind: Kind, variant: int) -> tuple[Made, frozenset[str]]:
        """The file and the notes that it has without damage; it must be read right."""
        if (name, variant) not in self._made:
            made = kind.make(np.random.default_rng([self._seed, variant]), self._folder)
            path = self._folder / f"whole{kind.suffix}"
            path.write_bytes(made.pack(made.data))
            recording = readers.read(path)
            found = compare(made.truth, recording)
            assert (found.right, found.wrong) == (made.truth.samples, 0), (name, found)
            assert not recording.gaps, (name, recording.gaps)
            self._made[name, variant] = made, _words(recording)
        return self._made[name, variant]


def _words(recording: Recording) -> frozenset[str]:
    """Notes without their numbers: another count is no new sentence, nor is a damaged name."""
    told = (part for note in recording.notes for part in note.split("; "))
    kept = (part for part in told if not _NAMES.search(part))
    return frozenset(re.sub(r"\d[\d.]*(e[-+]?\d+)?", "#", part) for part in kept)


def _judged(
    path: Path, made: Made, notes: frozenset[str], kind: Kind, in_blocks: bool
) -> tuple[str, str]:
    try:
        with limited(SECONDS):
            if in_blocks:
                recording = join(readers.blocks(path, block_samples=64), str(path))
            else:
                recording = readers.read(path)
    except BaseException as error:
        return failure(error)
    found = compare(made.truth, recording)
    told = bool(_words(recording) - notes or recording.gaps)
    lost_end = not found.missing_inside and not kind.length
    if found.wrong:
        outcome = "wrong, told" if told else "silent"
    elif found.right == made.truth.samples:
        outcome = "right"
    else:
        outcome = "told" if told else "right" if lost_end else "silent"
    return outcome, f"{found}{' in blocks' if in_blocks else ''}"


def failure(error: BaseException) -> tuple[str, str]:
    """The outcome of what a reader raised, and its words; what nobody may catch goes on."""
    text = f"{type(error).__name__}: {error}".replace("\n", " ")[:200]
    if isinstance(error, ImucalError):
        return "told", text
    if isinstance(error, TooLong):
        return "hang", f"more than {SECONDS} s"
    if not isinstance(error, Exception):
        raise error
    return "memory" if isinstance(error, MemoryError) else "traceback", text


@contextmanager
def limited(seconds: int) -> Iterator[None]:
    """Raise TooLong in what takes longer, and numpy's warnings, which nobody could act on."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TooLong

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
