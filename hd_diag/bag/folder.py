"""Files of a bag, their list in ``metadata.yaml``, and decompression of files or single messages."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import zstandard

from hd_diag.bag.block import Block, LongMessage
from hd_diag.bag.errors import BagError
from hd_diag.bag.mcap_chunk import AT_ONCE, LARGE, PIECE, believable
from hd_diag.bag.rosbag2 import UNREADABLE, load_yaml

_STORED = (".mcap", ".db3")
_PACKED = ".zstd"
_ZSTD_FRAME = np.frombuffer(b"\x28\xb5\x2f\xfd", np.uint8)  # first bytes of zstd data; CDR begins with 0
# Limit of the unpacked size [byte] plus a multiple [-] of the compressed size. Joint states that hardly
# change shrink to a hundredth.
_UNPACKED_LEAST = 1 << 30
_UNPACKED_RATIO = 100


@dataclass
class BagFiles:
    """Storage files of a bag in order, problems such as missing files, and whether messages are compressed.

    `counted` has the number of messages of each CDR topic from ``metadata.yaml``.
    """

    paths: list[Path] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    message_compression: bool = False
    counted: dict[str, int] = field(default_factory=dict)


def find_files(path: Path, *, lenient: bool = False) -> BagFiles:
    """Find the files of a bag, given a storage file, or a rosbag2 folder with or without metadata.

    With `lenient`, unreadable metadata are only noted as a problem, otherwise they raise BagError. A path
    without files always raises BagError.
    """
    if path.is_file():
        return BagFiles([path])
    if not path.is_dir():
        raise BagError(path, "is not a file or folder" if path.exists() else "does not exist")
    try:
        files = _listed(path)
    except BagError as exc:
        if not lenient:
            raise
        files = BagFiles(problems=[exc.cause])
    # The metadata of a killed recording may lack its last files. If a file and its compressed copy both
    # exist, the copy is unfinished.
    known = {_plain(file) for file in files.paths}
    for file in sorted(path.iterdir(), key=natural):
        if PurePath(_plain(file)).suffix in _STORED and _plain(file) not in known and file.is_file():
            known.add(_plain(file))
            files.paths.append(file)
    if not files.paths:
        other = next((f"; {file.name} is a ROS 1 bag" for file in sorted(path.glob("*.bag"))), "")
        inside = [file.parent for suffix in _STORED for file in path.glob(f"*/*{suffix}")]
        last = max(inside, key=lambda bag: bag.stat().st_mtime, default=None)
        other += f"; the last bag in it is {last}" if last else ""
        raise BagError(path, f"holds no .mcap or .db3 file{other}")
    return files


def _listed(folder: Path) -> BagFiles:
    """Files that ``metadata.yaml`` names."""
    path, files = folder / "metadata.yaml", BagFiles()
    if not path.is_file():
        return files
    try:
        info = load_yaml(path)["rosbag2_bagfile_information"]
        # Names only, because a path could lead out of the folder.
        names = dict.fromkeys(PurePath(name).name for name in info["relative_file_paths"])
        mode = (info.get("compression_mode") or "").lower()
        for topic in info.get("topics_with_message_count") or []:
            meta = topic["topic_metadata"]
            if meta["serialization_format"] == "cdr":
                files.counted[str(meta["name"])] = int(topic["message_count"])
    except UNREADABLE as exc:
        raise BagError(path, f"is not rosbag2 metadata: {exc}") from exc
    files.message_compression = mode == "message"
    for name in names:
        # The file may have been compressed or decompressed since.
        there = (folder / n for n in (name, name + _PACKED, name.removesuffix(_PACKED)) if n)
        file = next((file for file in there if file.is_file()), None)
        if file is None:
            files.problems.append(f"{name}: is named in metadata.yaml but missing")
        elif mode == "file" and file.suffix not in (*_STORED, _PACKED):
            raise BagError(folder, "its files are compressed, but not by zstd: decompress them first")
        elif file not in files.paths:
            files.paths.append(file)
    return files


def _plain(file: Path) -> str:
    """File name without the suffix of compression."""
    return file.name.removesuffix(_PACKED)


def natural(path: Path) -> list[tuple[int, str]]:
    """Sort key that puts ``bag_10`` after ``bag_9``."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def unpack(path: Path, stack: ExitStack, files: int = 1) -> tuple[Path, str]:
    """Path of the uncompressed file, and what is wrong with its compression, empty if nothing.

    A file that rosbag2 compressed as a whole is unpacked in a temporary folder, which `stack` deletes.
    BagError if the disk is full, or if the unpacked size is implausible for one of `files` files.
    """
    if path.suffix != _PACKED:
        return path, ""
    left = _UNPACKED_LEAST // files + _UNPACKED_RATIO * path.stat().st_size
    try:
        out = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hd_diag-")), path.stem)
        with path.open("rb") as stored, out.open("wb") as file:
            reader = zstandard.ZstdDecompressor().stream_reader(stored, read_across_frames=True)
            while part := reader.read(1 << 17):
                left -= len(part)
                if left < 0:
                    raise BagError(
                        path, f"decompresses to more than {_UNPACKED_RATIO} times its size and 1 GiB"
                    )
                file.write(part)
    except zstandard.ZstdError as exc:
        return out, f"its compression is damaged: {exc}"
    except OSError as exc:
        where = f"{tempfile.gettempdir()} (TMPDIR)"
        raise BagError(path, f"cannot be decompressed in {where}: {exc.strerror or exc}") from exc
    return out, ""  # a truncated file is noticed by its reader


def unpacked(path: Path, block: Block, stated: bool) -> Iterator[Block]:
    """Decompress messages if they are compressed; yields a few megabytes at once. BagError as `decompressed`.

    Unless the metadata `stated` compression, the first bytes of the messages decide.
    """
    begins = block.data[block.offset[block.size >= len(_ZSTD_FRAME)]]
    if not stated and not (begins == _ZSTD_FRAME[0]).any():
        yield block
        return
    first, found, size, zstd = 0, list[bytes | memoryview](), 0, zstandard.ZstdDecompressor()
    for row, message in enumerate(block.messages(), start=1):
        content = decompressed(path, message, zstd, stated)
        found.append(b"".join(content.read()) if isinstance(content, LongMessage) else content)
        size += len(found[-1])
        if size >= PIECE or row == len(block):
            yield block[first:row].holding(found)
            first, found, size = row, [], 0


def decompressed(
    path: Path, message: memoryview | LongMessage, zstd: zstandard.ZstdDecompressor, stated: bool
) -> bytes | memoryview | LongMessage:
    """Decompress a message of rosbag2; BagError if it is damaged or its unpacked size is implausible.

    Unless the metadata `stated` compression, a message that does not begin like zstd data is returned as it
    is. The caller passes one decompressor for many messages, because making it takes longer than using it.
    """

    def read() -> Iterator[bytes]:
        stored: Any = _Parts(message.read()) if isinstance(message, LongMessage) else message
        return zstd.read_to_iter(stored, AT_ONCE, AT_ONCE)

    limit = believable(len(message))
    head = next(message.read()) if isinstance(message, LongMessage) else message
    if not stated and head[: len(_ZSTD_FRAME)] != _ZSTD_FRAME.data:
        return message
    try:
        size = zstandard.get_frame_parameters(head).content_size
        if size != zstandard.CONTENTSIZE_UNKNOWN and size > limit:
            raise ValueError(f"it unpacks to {size} bytes, more than {limit}")
        if size != zstandard.CONTENTSIZE_UNKNOWN and size > LARGE:
            if sum(map(len, read())) != size:
                raise ValueError("it is cut off")
            return LongMessage(size, read)
        plain = b"".join(message.read()) if isinstance(message, LongMessage) else message
        return zstd.decompress(plain, max_output_size=limit)
    except (ValueError, zstandard.ZstdError, MemoryError) as exc:
        raise BagError(path, f"a compressed message is damaged: {exc}") from exc


class _Parts:
    """File-like object that reads from an iterator of parts."""

    def __init__(self, parts: Iterator[bytes | memoryview]) -> None:
        self._parts = parts

    def read(self, size: int = -1, /) -> bytes | memoryview:
        """The next part; its size need not be `size`."""
        return next(self._parts, b"")
