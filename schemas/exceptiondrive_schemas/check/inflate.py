"""Upload bytes to JSON bytes: sizes, gzip, and other file types, recognised by their first bytes.

Never inflates beyond a limit.
"""

import codecs
import json
import zlib
from dataclasses import dataclass
from types import ModuleType

from exceptiondrive_schemas.faults import FaultCode
from exceptiondrive_schemas.printable import counted

MAGIC_BYTES: tuple[tuple[bytes, str], ...] = (
    (b"PK\x03\x04", "a zip archive"),
    (b"PK\x05\x06", "an empty zip archive"),
    (b"\x93NUMPY", "a NumPy array (.npy)"),
    (b"PAR1", "a Parquet file"),
    (b"ARROW1", "an Arrow file"),
    (b"\x89HDF\r\n", "an HDF5 file"),
    (b"\x28\xb5\x2f\xfd", "Zstandard data"),
    (b"BZh", "bzip2 data"),
    (b"\xfd7zXZ\x00", "xz data"),
    (b"7z\xbc\xaf\x27\x1c", "a 7-Zip archive"),
    (b"Rar!\x1a\x07", "a RAR archive"),
    (b"\x78\x01", "zlib data without a gzip header"),
    (b"\x78\x9c", "zlib data without a gzip header"),
    (b"\x78\xda", "zlib data without a gzip header"),
    (b"\x1f\x8b", "gzip data inside gzip data"),
    (b"%PDF", "a PDF file"),
    (b"version https://git-lfs", "a pointer of Git LFS: git lfs pull brings the file"),
    (b"<", "an HTML or XML file"),
)
WIDE_TEXT = "UTF-16 or UTF-32 text"
STREAMS = "several gzip streams in a row, as `cat` makes of several files"
CONVERTIBLE = {"a Parquet file", "a NumPy archive (.npz)", WIDE_TEXT, STREAMS}
"""Kinds of file that `exceptiondrive convert` reads, if they hold what it looks for."""
PICKLE_PROTOCOLS = range(2, 6)
TAR_MAGIC, TAR_MAGIC_AT = b"ustar", 257
ZIP_HEAD_BYTES = 256
ENCODING_HEAD_BYTES = 64
"""A multiple of the bytes per character."""


def wide_encoding(data: bytes) -> str | None:
    """Return the encoding of UTF-16 or UTF-32 text, with or without a byte order mark."""
    head = data[:ENCODING_HEAD_BYTES]
    encoding = json.detect_encoding(head)
    if encoding.startswith("utf-8"):
        return None
    try:
        text = codecs.getincrementaldecoder(encoding)().decode(head)
    except UnicodeDecodeError:
        return None
    return encoding if "".join(text.split()).isprintable() else None


def other_file_kind(data: bytes) -> str | None:
    """Name the type, with its article, of an inflated file that is surely not JSON; else None."""
    if data[:1] == b"\x80" and data[1:2] and data[1] in PICKLE_PROTOCOLS:
        return "a Python pickle (never loaded: it could run code)"
    if data.startswith(TAR_MAGIC, TAR_MAGIC_AT):
        return "a tar archive"
    if data.startswith(b"PK") and b".npy" in data[:ZIP_HEAD_BYTES]:
        return "a NumPy archive (.npz)"
    for magic, name in MAGIC_BYTES:
        if data.startswith(magic):
            return name
    return WIDE_TEXT if wide_encoding(data) else None


MIB = 1024 * 1024
MAX_UPLOAD_BYTES = 16 * MIB
MAX_INFLATED_BYTES = 32 * MIB

GZIP_MAGIC = b"\x1f\x8b"
GZIP_WINDOW_BITS = 31


@dataclass
class UnreadableFileError(Exception):
    """The file cannot be checked further; holds the expected and the actual content, in words."""

    code: FaultCode
    expected: str
    got: str

    def __str__(self) -> str:
        return f"expected {self.expected}, got {self.got}"


def inflate(
    data: bytes,
    *,
    max_upload_bytes: int = MAX_UPLOAD_BYTES,
    max_inflated_bytes: int = MAX_INFLATED_BYTES,
    library: ModuleType = zlib,
) -> bytes:
    """Return the JSON bytes of an upload, which may be gzip-compressed.

    Args:
        data: The file as uploaded; gzip is recognised by its first bytes, not by a name.
        max_upload_bytes: Most bytes of the file itself.
        max_inflated_bytes: Most bytes of its content; no more are ever inflated.
        library: The decompressor: `zlib`, or a module with the same interface and errors.

    Raises:
        UnreadableFileError: Empty, too large, damaged, or a file of another kind.
    """
    if len(data) > max_upload_bytes:
        raise UnreadableFileError(
            FaultCode.FILE_TOO_LARGE,
            f"at most {counted(max_upload_bytes, 'byte')}",
            counted(len(data), "byte"),
        )
    inflated = _gunzip(data, max_inflated_bytes, library) if data.startswith(GZIP_MAGIC) else data
    if len(inflated) > max_inflated_bytes:
        raise UnreadableFileError(
            FaultCode.INFLATES_TOO_LARGE,
            f"at most {counted(max_inflated_bytes, 'byte')} of JSON",
            "more",
        )
    if not inflated:
        raise UnreadableFileError(FaultCode.EMPTY_FILE, "a JSON document", "no bytes")
    other = other_file_kind(inflated)
    if other is not None:
        raise UnreadableFileError(FaultCode.WRONG_FILE_KIND, "JSON, plain or gzip", other)
    return inflated


def _gunzip(data: bytes, max_inflated_bytes: int, library: ModuleType) -> bytes:
    inflater = library.decompressobj(wbits=GZIP_WINDOW_BITS)
    try:
        inflated: bytes = inflater.decompress(data, max_inflated_bytes + 1)
    except library.error:
        raise _damaged_gzip("data that cannot be inflated, or that fails its checksum") from None
    if len(inflated) > max_inflated_bytes:
        return inflated
    if not inflater.eof:
        raise _damaged_gzip(
            "a stream that stops before its end; was the upload or the copy cut off?"
        )
    if inflater.unused_data.startswith(GZIP_MAGIC):
        raise _damaged_gzip(STREAMS)
    if inflater.unused_data:
        raise _damaged_gzip(f"{counted(len(inflater.unused_data), 'byte')} after the stream's end")
    return inflated


def _damaged_gzip(got: str) -> UnreadableFileError:
    return UnreadableFileError(FaultCode.DAMAGED_GZIP, "one complete gzip stream", got)
