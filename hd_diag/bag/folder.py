"""Which files make up a bag, and what ``metadata.yaml`` says of them."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any, BinaryIO

import yaml
import zstandard

from hd_diag.bag.errors import BagError
from hd_diag.bag.mcap_chunk import unzstd
from hd_diag.bag.mcap_scan import MAX_CHUNK
from hd_diag.bag.rosbag2 import load_yaml

_MAX_YAML = 4 << 20
_STORED = (".mcap", ".db3")
_PACKED = ".zstd"
# What a compressed bag may unpack to: joint states that hardly change shrink to a hundredth [byte], [-].
_UNPACKED_LEAST = 1 << 30
_UNPACKED_RATIO = 100


@dataclass
class BagFiles:
    """Storage files of a bag in order.

    Attributes
    ----------
    paths : list of Path
    problems : list of str
        Files that are named but missing.
    custom_data : dict
        From the metadata.
    message_compression : bool
        Whether rosbag2 compressed each message.
    """

    paths: list[Path] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    custom_data: dict[str, str] = field(default_factory=dict)
    message_compression: bool = False


def find_files(path: Path, *, lenient: bool = False) -> BagFiles:
    """Storage files of a bag.

    Parameters
    ----------
    path : Path
        A storage file, or a rosbag2 folder with or without metadata.
    lenient : bool, optional
        Do without metadata that cannot be understood.

    Raises
    ------
    BagError
        Where there are none.
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
    # A recording that was killed may have files that its metadata does not know yet.
    found = {p.name: p for p in path.iterdir() if _plain(p.name).suffix in _STORED and p.is_file()}
    # Of a file and its compressed copy the copy is the unfinished one.
    whole = [p for name, p in found.items() if p.suffix != _PACKED or _plain(name).name not in found]
    known = {_plain(p.name) for p in files.paths}
    files.paths += sorted((p for p in whole if _plain(p.name) not in known), key=_natural)
    if not files.paths:
        raise BagError(path, "holds no .mcap or .db3 file")
    return files


class Unpacked:
    """Storage files as they stand, those that rosbag2 compressed as a whole in a temporary folder.

    Parameters
    ----------
    paths : iterable of Path
        The files; what they may unpack to is bounded by their size.
    """

    def __init__(self, paths: Iterable[Path] = ()) -> None:
        sizes = sum(p.stat().st_size for p in paths if p.suffix == _PACKED)
        self._left = _UNPACKED_LEAST + _UNPACKED_RATIO * sizes
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    def file(self, path: Path) -> tuple[Path, str]:
        """Where the content of a file can be read, and what is wrong with its compression.

        Raises
        ------
        BagError
            Where it does not fit on the disk, or unpacks to more than can be believed.
        """
        if path.suffix != _PACKED:
            return path, ""
        try:
            self._folder = self._folder or workspace(path, 0)
            out = Path(self._folder.name, path.stem)
            with path.open("rb") as stored, out.open("wb") as file:
                return out, self._unpack(path, stored, file)
        except OSError as exc:
            where = tempfile.gettempdir()
            raise BagError(
                path, f"cannot be decompressed in {where} (TMPDIR): {exc.strerror or exc}"
            ) from exc

    def close(self) -> None:
        """Delete what was unpacked."""
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def _unpack(self, path: Path, stored: BinaryIO, file: BinaryIO) -> str:
        """A cut is told by what was in the file, which misses its end."""
        reader = zstandard.ZstdDecompressor().stream_reader(stored, read_across_frames=True)
        try:
            while part := reader.read(1 << 17):
                self._left -= len(part)
                if self._left < 0:
                    raise BagError(
                        path, f"decompresses to more than {_UNPACKED_RATIO} times its size and 1 GiB"
                    )
                file.write(part)
        except zstandard.ZstdError as exc:
            return f"its compression is damaged: {exc}"
        return ""


def workspace(path: Path, size: int) -> tempfile.TemporaryDirectory[str]:
    """A temporary folder for what needs `size` bytes on the disk.

    Raises
    ------
    BagError
        Where there is no room.
    """
    where = tempfile.gettempdir()
    free = shutil.disk_usage(where).free
    if size > free:
        raise BagError(path, f"needs {size} bytes in {where} (TMPDIR), where {free} are free")
    return tempfile.TemporaryDirectory(prefix="hd_diag-", dir=where)


def unpacked(path: Path, messages: Iterable[Any]) -> list[memoryview]:
    """Messages that rosbag2 compressed one by one.

    Raises
    ------
    BagError
        Where one is damaged.
    """
    zstd = zstandard.ZstdDecompressor()
    try:
        return [memoryview(unzstd(bytes(m), MAX_CHUNK, zstd)) for m in messages]
    except (ValueError, zstandard.ZstdError, MemoryError) as exc:
        raise BagError(path, f"a compressed message is damaged: {exc}") from exc


def custom_data(metadata: str) -> dict[str, str]:
    """Custom data of the metadata inside an MCAP file; none where it cannot be understood."""
    try:
        return _texts(load_yaml(metadata)["custom_data"])
    except (yaml.YAMLError, KeyError, TypeError, ValueError, RecursionError):
        return {}


def _texts(extra: Any) -> dict[str, str]:
    pairs = extra.items() if isinstance(extra, dict) else ()
    return {k: v for k, v in pairs if isinstance(k, str) and isinstance(v, str)}


def _listed(folder: Path) -> BagFiles:
    """Files that ``metadata.yaml`` names."""
    path = folder / "metadata.yaml"
    if not path.is_file():
        return BagFiles()
    if path.stat().st_size > _MAX_YAML:
        raise BagError(path, "is too large")
    try:
        info = load_yaml(path.read_bytes())["rosbag2_bagfile_information"]
        # Only names: a path could lead out of the folder.
        names = dict.fromkeys(PurePath(name).name for name in info["relative_file_paths"])
        mode = (info.get("compression_mode") or "").lower()
        extra = info.get("custom_data")
    except (yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError, RecursionError) as exc:
        raise BagError(path, f"is not rosbag2 metadata: {exc}") from exc
    paths = {name: _present(folder, name) for name in names}
    there = list(dict.fromkeys(path for path in paths.values() if path is not None))
    if mode == "file" and any(path.suffix not in (*_STORED, _PACKED) for path in there):
        raise BagError(folder, "its files are compressed, but not by zstd: decompress them first")
    missing = [f"{name}: is named in metadata.yaml but missing" for name, path in paths.items() if not path]
    return BagFiles(there, missing, _texts(extra), mode == "message")


def _present(folder: Path, name: str) -> Path | None:
    """A file that metadata names, which may have been compressed or decompressed since."""
    stem = PurePath(name).stem
    names = [name, f"{name}{_PACKED}", *([stem] if PurePath(stem).suffix in _STORED else [])]
    return next((folder / n for n in names if name and (folder / n).is_file()), None)


def _plain(name: str) -> PurePath:
    """Name of a file when it is decompressed."""
    return PurePath(name.removesuffix(_PACKED))


def _natural(path: Path) -> list[tuple[int, str]]:
    """Key that sorts ``bag_10`` after ``bag_9``."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]
