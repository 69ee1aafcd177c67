"""MCAP chunks: decompression with every check that the format offers, and the cut last chunk."""

from __future__ import annotations

import zlib
from collections.abc import Iterator

from imucalib.readers.messages.records import COMPRESSIONS, ChunkHead, MalformedRecordError

#: Bytes of a packed chunk's records unless --max-chunk says otherwise; writers use 1 to 4 MiB. A
#: header may lie, and 4 bytes of zstd may stand for 128 KiB.
MAX_CHUNK = 64 << 20
_LZ4_MOST = 256  # an LZ4 block cannot expand further than 255 times
_PIECE = 1 << 16


def unpack_chunk(head: ChunkHead, body: bytes, most: int = MAX_CHUNK) -> bytes:
    """The records of a whole chunk, size and CRC checked; raises MalformedRecordError.

    most : bytes; a packed chunk that claims more is refused
    """
    _judge(head, body, most)
    try:
        # One byte more than is due shows that there is more.
        data = b"".join(_unpacked(head.compression, body, head.uncompressed_size + 1))
    except Exception as error:  # the two libraries raise unrelated types for damaged data
        raise MalformedRecordError(f"the {head.compression} data is damaged") from error
    if len(data) != head.uncompressed_size:
        raise MalformedRecordError("the chunk's size differs from its header")
    if head.uncompressed_crc and zlib.crc32(data) != head.uncompressed_crc:
        raise MalformedRecordError("the chunk's CRC differs from its header")
    return data


def unpack_cut_chunk(head: ChunkHead, body: bytes, most: int = MAX_CHUNK) -> bytes:
    """What can be decompressed of a chunk whose end is missing; nothing checks it."""
    try:
        _judge(head, body, most)
    except MalformedRecordError:
        return b""
    pieces: list[bytes] = []
    left = head.uncompressed_size
    try:
        for piece in _unpacked(head.compression, body, left + 1, _PIECE):
            pieces.append(piece)
            left -= len(piece)
            if left < 0:
                return b""
    except Exception:  # what came before the damage is kept
        pass
    return b"".join(pieces)


def _judge(head: ChunkHead, body: bytes, most: int) -> None:
    size = head.uncompressed_size
    if head.compression not in COMPRESSIONS:
        raise MalformedRecordError(f"unknown chunk compression {head.compression!r}")
    if head.compression and size > most:
        raise MalformedRecordError(f"the chunk claims {size} bytes, more than --max-chunk {most}")
    if head.compression == "lz4" and size > _LZ4_MOST * len(body):
        raise MalformedRecordError("the chunk's size differs from its header")


def _unpacked(compression: str, body: bytes, most: int, piece: int = 0) -> Iterator[bytes]:
    """At most `most` bytes of content, in pieces."""
    if compression == "":
        yield body
        return
    piece = piece or most
    if compression == "lz4":
        import lz4.frame

        unpacker = lz4.frame.LZ4FrameDecompressor()
        feed = body
        while most > 0 and not unpacker.eof:
            part = unpacker.decompress(feed, max_length=min(most, piece))
            feed, most = b"", most - len(part)
            yield part
            if not part and unpacker.needs_input:
                return
        return
    from imucalib.readers.mcap import zstd

    yield from zstd.frames(body, most, piece)
