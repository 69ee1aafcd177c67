"""GENEActiv: .bin files, text of a header and of pages, plain or gzipped.

A page is "Recorded Data", eight lines of the form name:value, and a line of 3600 hexadecimal
digits: 300 samples of 48 bits, x, y and z in 12 bits each (two's complement), light in 10, the
button in 1. The header's calibration gives g: (100 raw - offset) / gain. Layout: GENEActiv
instruction manual, appendix on the binary file. The format has no checksum.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.devices.packets import Log, Packets, Stream, head_unpacked, opened, recordings
from imucalib.readers.joining import Joined
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording

_FIRST, _PAGE = b"Device Identity", b"Recorded Data"
_DIGITS, _PER_PAGE, _PAGE_BYTES = 3600, 300, 3900
_MOST_BAD = 100_000  # damaged pages: more than 100 Hz of three days
_DRIFT = 0.01  # a quartz sets the pace
#: Longest header, and bytes without a page after which the file is no recording.
_MOST_HEADER, _MOST_WASTE = 1 << 16, 16 << 20


@dataclass(frozen=True)
class _Header:
    """gain, offset : (3,) of the calibration; zone_s : of the clock, east of UTC, or None;
    pages : that the file states, or None
    """

    gain: Array
    offset: Array
    zone_s: int | None
    serial: str
    pages: int | None


@dataclass
class _Loss:
    """Pages that could not be read, why the first, and bytes in no page."""

    pages: int = 0
    why: str = ""
    strict: bool = False
    where: str = ""
    lost: list[str] = field(default_factory=list)

    def page(self, why: str, number: int) -> None:
        """Count a damaged page; raises with `strict`."""
        if self.strict:
            raise UnreadableInput(why, where=f"{self.where}, page {number}")
        if self.pages > _MOST_BAD:
            raise UnreadableInput("hardly a page of it is whole", where=self.where)
        self.pages, self.why = self.pages + 1, self.why or f"page {number}: {why}"

    def told(self, stated: int | None, found: int) -> None:
        """The sentences that the recording carries; raises with `strict` where pages are missing.

        A device that stopped by itself states its pages as it found them: fewer are a cut.
        """
        if self.pages:
            self.lost.append(f"{self.pages} pages left out; {self.why}")
        if stated is None or found >= stated:
            return
        what = f"the header states {stated} pages, {found} were found"
        if self.strict:
            raise UnreadableInput(what, where=self.where)
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
        loss = _Loss(strict=strict, where=str(path))
        with opened(path, strict=strict, lost=loss.lost) as stream:
            pages = _pages(stream, _PAGE_BYTES * max(1, block_samples // _PER_PAGE), str(path))
            header = _header(next(pages, [b""])[0], str(path))
            clock = "the time zone is not in the file: times are the wearer's"
            notes = (f"GENEActiv {header.serial}",) + (clock,) * (header.zone_s is None)
            packets = _packets(pages, header, loss)
            log = Log(self.name, packets, notes, loss.lost, _DRIFT, header.zone_s or 0)
            yield from recordings(log, path, mapping)


READER = GeneactivReader()


def _pages(stream: Stream, size: int, where: str) -> Iterator[list[bytes]]:
    """First the header, then pages, as many at a time as `size` bytes hold."""
    rest, headed = b"", False
    while True:
        piece = stream.read(max(size, _PAGE_BYTES))
        found = (rest + piece).split(_PAGE)
        rest = found.pop() if piece else b""
        if not headed and found:
            yield found[:1]
            found, headed = found[1:], True
        if found:
            yield found
        if not piece:
            return
        if len(rest) > (_MOST_WASTE if headed else _MOST_HEADER) + size:
            raise UnreadableInput("this holds no pages of GENEActiv", where=where)
        rest = rest if not headed or found or rest else b""


def _header(text: bytes, where: str) -> _Header:
    facts = _facts(text.decode("latin-1"))
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
    zone = re.search(r"([+-])(\d{1,2}):(\d{2})", facts.get("Time Zone", ""))
    size = 3600 * int(zone[2]) + 60 * int(zone[3]) if zone else None
    serial = facts.get("Device Unique Serial Code", "of unknown number")
    pages = facts.get("Number of Pages", "")
    return _Header(
        gain=gain,
        offset=offset,
        serial=serial,
        pages=int(pages) if pages.isdecimal() else None,
        zone_s=-size if size and zone and zone[1] == "-" else size,
    )


def _facts(text: str) -> dict[str, str]:
    pairs = (line.split(":", 1) for line in text.splitlines() if ":" in line)
    return {name.strip(): value.strip() for name, value in pairs}


def _packets(pages: Iterator[list[bytes]], header: _Header, loss: _Loss) -> Iterator[Packets]:
    number = 0
    for group in pages:
        stamps, rates, warm, raw = list[int](), list[float](), list[float](), list[Array]()
        for page in group:
            number += 1
            try:
                facts, samples = _page(page)
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
            raw.append((samples * 100.0 - header.offset) / header.gain)
        if stamps:
            acc = np.concatenate(raw)
            count = np.full(len(stamps), _PER_PAGE)
            yield Packets(
                stamp=np.array(stamps),
                at=np.zeros_like(count),
                count=count,
                rate=np.array(rates),
                warm=np.array(warm),
                acc=acc,
                gyro=np.full(acc.shape, np.nan),
            )
    loss.told(header.pages, number)


def _number(text: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return float("nan")


def _page(page: bytes) -> tuple[dict[str, str], NDArray[np.int64]]:
    """The lines of a page, and its raw samples (300, 3). Raises ValueError."""
    lines = page.split()
    digits = lines[-1] if lines else b""
    if len(digits) != _DIGITS:
        raise ValueError(f"{len(digits)} of {_DIGITS} digits")
    codes = np.frombuffer(bytes.fromhex(digits.decode("ascii")), np.uint8).reshape(-1, 6)
    wide = codes.astype(np.int64)
    axes = np.stack(
        [
            wide[:, 0] << 4 | wide[:, 1] >> 4,
            (wide[:, 1] & 15) << 8 | wide[:, 2],
            wide[:, 3] << 4 | wide[:, 4] >> 4,
        ],
        axis=1,
    )
    return _facts(page.decode("latin-1")), np.where(axes > 2047, axes - 4096, axes)
