"""Recognises files of other kinds by their first bytes, so that the report can name them."""

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
    (b"\xff\xfe", "UTF-16 text"),
    (b"\xfe\xff", "UTF-16 text"),
    (b"<", "an HTML or XML file"),
)
PICKLE_PROTOCOLS = range(2, 6)
TAR_MAGIC, TAR_MAGIC_AT = b"ustar", 257
ZIP_HEAD_BYTES = 256


def other_file_kind(data: bytes) -> str | None:
    """Name the kind of a file that is certainly not JSON.

    Args:
        data: The file, inflated if it was gzip.

    Returns:
        A name with its article, or None where the file may be JSON.
    """
    if data[:1] == b"\x80" and data[1:2] and data[1] in PICKLE_PROTOCOLS:
        return "a Python pickle (never loaded: it could run code)"
    if data.startswith(TAR_MAGIC, TAR_MAGIC_AT):
        return "a tar archive"
    if data.startswith(b"PK") and b".npy" in data[:ZIP_HEAD_BYTES]:
        return "a NumPy archive (.npz)"
    for magic, name in MAGIC_BYTES:
        if data.startswith(magic):
            return name
    return None
