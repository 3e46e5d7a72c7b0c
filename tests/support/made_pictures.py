"""Pictures written byte by byte, for tests."""

import struct
import zlib


def png(width_px: int, height_px: int, *texts: str) -> bytes:
    """Return a grey picture as a PNG file, with comments in it."""
    header = struct.pack(">IIBBBBB", width_px, height_px, 8, 0, 0, 0, 0)
    rows = b"".join(
        b"\0" + bytes((7 * x + 3 * y) % 256 for x in range(width_px)) for y in range(height_px)
    )
    comments = b"".join(_chunk(b"tEXt", b"Comment\0" + text.encode()) for text in texts)
    body = _chunk(b"IHDR", header) + comments + _chunk(b"IDAT", zlib.compress(rows))
    return b"\x89PNG\r\n\x1a\n" + body + _chunk(b"IEND", b"")


def png_that_says(width_px: int, height_px: int) -> bytes:
    """Return a picture of one pixel as a PNG file that says another size."""
    one = png(1, 1)
    header = one[12:16] + struct.pack(">II", width_px, height_px) + one[24:29]
    return one[:12] + header + struct.pack(">I", zlib.crc32(header)) + one[33:]


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
