"""GENEActiv: .bin files, text of a header and of pages, plain or gzipped; CSV exports of its
software.

A page is "Recorded Data", eight lines of the form name:value, and a line of 3600 hexadecimal
digits: 300 samples of 48 bits, x, y and z in 12 bits each (two's complement), light in 10, the
button in 1. The header's calibration gives g: (100 raw - offset) / gain. Layout: GENEActiv
instruction manual, appendix on the binary file. The format has no checksum.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.devices.catalogue import Device
from imucalib.readers.devices.packets import (
    Log,
    Packets,
    Stream,
    head_unpacked,
    open_packets,
    packets_of,
    recordings,
    unpack_twelve_bits,
    zone_of,
)
from imucalib.readers.fields.joining import Joined
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording

_FIRST, _PAGE = b"Device Identity", b"Recorded Data"
_DIGITS, _PER_PAGE, _PIECE = 3600, 300, 1 << 19  # _PIECE: bytes that are read at a time
_MOST_BAD = 100_000  # damaged pages: more than 100 Hz of three days
_DRIFT = 0.01  # a quartz sets the pace
#: Longest header, and bytes without a page after which the file is no recording.
_MOST_HEADER, _MOST_WASTE = 1 << 16, 16 << 20
DEVICE = Device(
    "geneactiv",
    FieldMapping(
        time="1",
        acc=("2", "3", "4"),
        temperature=("7",),
        time_unit="text",
        time_format="%Y-%m-%d %H:%M:%S:%f",
        acc_unit="g",
        temperature_unit="degC",
    ),
    words=("geneactiv",),
    source="harvard-nrg/pygeneactiv, tests/right_wrist.csv (blanks at the ends of lines left out)",
)


@dataclass
class _Loss:
    """Pages that could not be read, and why the first; lost : the sentences on them."""

    strict: bool
    where: str
    lost: list[str]
    pages: int = 0
    why: str = ""

    def refuse(self, what: str, number: int | None = None) -> None:
        """Raise UnreadableInput where a damaged file is not wanted."""
        if self.strict:
            page = "" if number is None else f", page {number}"
            raise UnreadableInput(what, where=self.where + page)

    def page(self, why: str, number: int) -> None:
        """Count a damaged page."""
        self.refuse(why, number)
        if self.pages > _MOST_BAD:
            raise UnreadableInput("hardly a page of it is whole", where=self.where)
        self.pages, self.why = self.pages + 1, self.why or f"page {number}: {why}"

    def finish(self, stated: str, found: int) -> None:
        """Sum it up. A device that stopped by itself states its pages as it found them: fewer are
        a cut."""
        if self.pages:
            self.lost.append(f"{self.pages} pages left out; {self.why}")
        if stated.isdecimal() and found < int(stated):
            what = f"the header states {int(stated)} pages, {found} were found"
            self.refuse(what)
            self.lost.append(what)


class GeneactivReader(Joined):
    """The reader of GENEActiv's own files."""

    name = "geneactiv"
    suffixes = (".bin", ".bin.gz")
    fixed = True

    def recognises(self, path: Path, head: bytes) -> bool:
        """The header's first line."""
        return head_unpacked(head, 64).startswith(_FIRST)

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Read in blocks of whole pages; damage costs its page."""
        loss = _Loss(strict, str(path), [])
        with open_packets(path, strict=strict, lost=loss.lost) as stream:
            pages = _pages(stream, str(path))
            facts = _facts(next(pages, [b""])[0])
            gain, offset = _calibration(facts, str(path))
            zone_s = zone_of(facts.get("Time Zone", ""))
            serial = facts.get("Device Unique Serial Code", "")
            notes = [f"GENEActiv {serial or 'of unknown number'}"]
            if zone_s is None:
                notes.append("the time zone is not in the file: times are the wearer's")
            packets = _packets(pages, gain, offset, facts.get("Number of Pages", ""), loss)
            log = Log(
                self.name,
                packets,
                tuple(notes),
                loss.lost,
                _DRIFT,
                zone_s or 0,
                cut=True,
                device="GENEActiv",
                serial=serial,
            )
            yield from recordings(log, path, mapping, block_samples)


READER = GeneactivReader()


def _pages(stream: Stream, where: str) -> Iterator[list[bytes]]:
    """First the header, then pages, some at a time."""
    rest, headed = b"", False
    while True:
        piece = stream.read(_PIECE)
        found = (rest + piece).split(_PAGE)
        rest = found.pop() if piece else b""
        if not headed and found:
            yield found[:1]
            found, headed = found[1:], True
        if found:
            yield found
        if not piece:
            return
        if len(rest) > (_MOST_WASTE if headed else _MOST_HEADER) + _PIECE:
            raise UnreadableInput("this holds no pages of GENEActiv", where=where)


def _facts(text: bytes) -> dict[str, str]:
    pairs = (line.split(":", 1) for line in text.decode("latin-1").splitlines() if ":" in line)
    return {name.strip(): value.strip() for name, value in pairs}


def _calibration(facts: dict[str, str], where: str) -> tuple[Array, Array]:
    """Gain and offset (3,) each."""
    try:
        gain = np.array([float(facts[f"{a} gain"]) for a in "xyz"])
        offset = np.array([float(facts[f"{a} offset"]) for a in "xyz"])
    except (KeyError, ValueError):
        gain, offset = np.zeros(3), np.zeros(3)
    if not (np.isfinite(offset).all() and (gain > 0.0).all() and np.isfinite(gain).all()):
        raise UnreadableInput(
            "the header does not state the gain and offset of the axes",
            where=where,
            remedy="copy the file from the device again",
        )
    return gain, offset


def _packets(
    pages: Iterator[list[bytes]], gain: Array, offset: Array, stated: str, loss: _Loss
) -> Iterator[Packets]:
    """stated : how many pages the header says there are"""
    number = 0
    for group in pages:
        stamps, rates, warm, raw = list[int](), list[float](), list[float](), list[Array]()
        for page in group:
            number += 1
            try:
                samples, facts = _samples(page), _facts(page)
                stamp = datetime.strptime(facts["Page Time"], "%Y-%m-%d %H:%M:%S:%f")
                rate = float(facts["Measurement Frequency"].split()[0].replace(",", "."))
            except (KeyError, ValueError, IndexError) as error:
                loss.page(f"it is damaged: {error}"[:80], number)
                continue
            if not 1.0 <= rate <= 10_000.0:
                loss.page(f"it states {rate} Hz", number)
                continue
            stamps.append(round(stamp.replace(tzinfo=UTC).timestamp() * 1000) * 1_000_000)
            rates.append(rate)
            warm.append(_number(facts.get("Temperature", "")))
            raw.append((samples * 100.0 - offset) / gain)
        if stamps:
            yield packets_of(
                np.concatenate(raw),
                stamp=np.array(stamps),
                count=_PER_PAGE,
                rate=np.array(rates),
                warm=np.array(warm),
            )
    loss.finish(stated, number)


def _number(text: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return float("nan")


def _samples(page: bytes) -> NDArray[np.int16]:
    """The raw samples (300, 3) of a page. Raises ValueError."""
    lines = page.split()
    digits = lines[-1] if lines else b""
    if len(digits) != _DIGITS:
        raise ValueError(f"{len(digits)} of {_DIGITS} digits")
    return unpack_twelve_bits(bytes.fromhex(digits.decode("ascii"))).reshape(-1, 4)[:, :3]
