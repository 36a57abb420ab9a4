"""Which files make up a bag, and what ``metadata.yaml`` says of them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

import yaml
import zstandard

from .errors import BagError
from .mcap_chunk import unzstd
from .mcap_scan import MAX_CHUNK
from .rosbag2 import load_yaml

_MAX_YAML = 4 << 20


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
    found = {p for p in path.iterdir() if p.suffix in (".mcap", ".db3") and p.is_file()}
    # A recording that was killed may have files that its metadata does not know yet.
    files.paths += sorted(found - set(files.paths), key=_natural)
    if not files.paths:
        raise BagError(path, "holds no .mcap or .db3 file")
    return files


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
    if mode == "file":
        raise BagError(folder, "its files are compressed as a whole: decompress them with zstd -d first")
    there = [folder / name for name in names if name and (folder / name).is_file()]
    missing = [
        f"{name}: is named in metadata.yaml but missing" for name in names if folder / name not in there
    ]
    return BagFiles(there, missing, _texts(extra), mode == "message")


def _natural(path: Path) -> list[tuple[int, str]]:
    """Key that sorts ``bag_10`` after ``bag_9``."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]
