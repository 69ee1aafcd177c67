"""Zstandard: Python's own from 3.14 on, its backport before."""

from __future__ import annotations

import sys
from collections.abc import Iterator

if sys.version_info >= (3, 14):
    from compression.zstd import ZstdDecompressor, ZstdError, compress, get_frame_info
else:
    from backports.zstd import ZstdDecompressor, ZstdError, compress, get_frame_info

__all__ = ["ZstdError", "compress", "first_frame", "frames"]


def frames(body: bytes, most: int, piece: int) -> Iterator[bytes]:
    """At most `most` bytes of all frames, in pieces of at most `piece`; raises ZstdError."""
    while body and most > 0:
        unpacker, feed = ZstdDecompressor(), body
        while most > 0 and not unpacker.eof:
            part = unpacker.decompress(feed, max_length=min(most, piece))
            feed, most = b"", most - len(part)
            yield part
            if not part and unpacker.needs_input:
                return
        body = unpacker.unused_data


def first_frame(payload: bytes, most: int) -> bytes:
    """The first frame whole; raises ZstdError where it is damaged, breaks off or is beyond `most`
    bytes."""
    stated = get_frame_info(payload).decompressed_size
    if stated is not None and stated > most:
        raise ZstdError(f"the frame claims {stated} bytes")
    unpacker = ZstdDecompressor()
    data = unpacker.decompress(payload, max_length=most)
    if not unpacker.eof:
        raise ZstdError("the frame breaks off or is too long")
    return data
