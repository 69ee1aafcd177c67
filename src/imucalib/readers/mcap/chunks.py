"""MCAP chunks: decompression with every check that the format offers, and the cut last chunk."""

from __future__ import annotations

import zlib

from imucalib.readers.messages.records import COMPRESSIONS, ChunkHead, MalformedRecordError

_LZ4_MOST = 256  # an LZ4 block cannot expand further than 255 times
_PIECE = 1 << 16


def unpack_chunk(head: ChunkHead, body: bytes) -> bytes:
    """The records of a whole chunk, size and CRC checked; raises MalformedRecordError."""
    if head.compression not in COMPRESSIONS:
        raise MalformedRecordError(f"unknown chunk compression {head.compression!r}")
    try:
        data = _decompress(head, body)
    except MalformedRecordError:
        raise
    except (RuntimeError, ValueError, MemoryError, OSError, EOFError) as error:
        raise MalformedRecordError(f"the {head.compression} data is damaged") from error
    if len(data) != head.uncompressed_size:
        raise MalformedRecordError("the chunk's size differs from its header")
    if head.uncompressed_crc and zlib.crc32(data) != head.uncompressed_crc:
        raise MalformedRecordError("the chunk's CRC differs from its header")
    return data


def _decompress(head: ChunkHead, body: bytes) -> bytes:
    if head.compression == "":
        return body
    if head.compression == "lz4":
        import lz4.frame

        if head.uncompressed_size > _LZ4_MOST * len(body):
            raise MalformedRecordError("the chunk's size differs from its header")
        return bytes(lz4.frame.decompress(body))
    import zstandard

    try:
        declared = zstandard.frame_content_size(body)
        if declared == head.uncompressed_size:
            return bytes(zstandard.ZstdDecompressor().decompress(body))
        if declared >= 0 and declared > head.uncompressed_size:
            raise MalformedRecordError("the chunk's size differs from its header")
        return _zstd_stream(body, head.uncompressed_size)
    except zstandard.ZstdError as error:
        raise MalformedRecordError("the zstd data is damaged") from error


def _zstd_stream(body: bytes, most: int) -> bytes:
    """Frames without a declared size, or several of them, never beyond `most` bytes."""
    import zstandard

    pieces, total, rest = [], 0, body
    while rest:
        frame = zstandard.ZstdDecompressor().decompressobj()
        for at in range(0, len(rest), _PIECE):
            piece = frame.decompress(rest[at : at + _PIECE])
            pieces.append(piece)
            total += len(piece)
            if total > most:
                raise MalformedRecordError("the chunk's size differs from its header")
            if frame.eof:
                rest = frame.unused_data + rest[at + _PIECE :]
                break
        else:
            raise MalformedRecordError("the zstd data ends too early")
    return b"".join(pieces)


def unpack_cut_chunk(head: ChunkHead, body: bytes) -> bytes:
    """What can be decompressed of a chunk whose end is missing; nothing checks it."""
    if head.compression == "":
        return body
    if head.compression not in COMPRESSIONS:
        return b""
    if head.compression == "lz4":
        import lz4.frame

        unpacker = lz4.frame.LZ4FrameDecompressor()
    else:
        import zstandard

        unpacker = zstandard.ZstdDecompressor().decompressobj()
    pieces: list[bytes] = []
    total = 0
    for at in range(0, len(body), _PIECE):
        try:
            pieces.append(unpacker.decompress(body[at : at + _PIECE]))
        except Exception:  # the two libraries raise unrelated types for data past the cut
            break
        total += len(pieces[-1])
        if total > head.uncompressed_size:
            return b""
    return b"".join(pieces)
