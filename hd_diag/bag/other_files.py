"""Recognises files that are not bags by their first bytes, and says what to do with them."""

from __future__ import annotations

PEEKED = 512
"""First bytes of a file that are needed to recognise it."""

_BEGINS = {
    b"#ROSBAG V": "is a ROS 1 bag: `rosbags-convert --src FILE --dst FOLDER` makes a ROS 2 bag of it",
    b"\x1f\x8b": "is compressed by gzip: decompress it first",
    b"PK\3\4": "is a zip archive: unpack it first",
    b"BZh": "is compressed by bzip2: decompress it first",
    b"\xfd7zXZ\0": "is compressed by xz: decompress it first",
    b"\x28\xb5\x2f\xfd": "is compressed by zstd: its name must end with .zstd, or decompress it first",
    b"\x04\x22\x4d\x18": "is compressed by lz4: decompress it first",
    b"\x89HDF": "is not an MCAP file but HDF5",
    b"PAR1": "is not an MCAP file but Parquet",
}
_TEXT = "is not an MCAP file but text; a table's name ends with .csv, .tsv or .txt"


def told(head: bytes) -> str:
    """Why a file with these first bytes is not a bag."""
    if not head:
        return "is empty"
    for begin, what in _BEGINS.items():
        if head.startswith(begin):
            return what
    return _TEXT if _is_text(head) else "is not an MCAP file"


def _is_text(head: bytes) -> bool:
    """Whether bytes are lines of text in UTF-8, or UTF-16 with its mark; the last character may be cut."""
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return True
    if b"\n" not in head:
        return False
    text = head.decode("utf-8", "ignore")
    is_whole = len(text.encode()) > len(head) - 4
    return is_whole and all(
        character.isprintable() or character.isspace() for character in text.lstrip("\ufeff")
    )
