"""Messages of overlapping chunks in the order of their log times, with no more in memory than overlaps."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from hd_diag.bag.block import Block
from hd_diag.bag.mcap_storage import Stretch

# Chunks are taken together up to this size, so that what follows works on long columns [byte].
_TARGET = 4 << 20
# More than this is never held back for sorting [byte].
MAX_PENDING = 1 << 30


def turns(stretches: Sequence[Stretch]) -> list[int]:
    """Numbers of the stretches in the order in which they are needed, and loaded."""
    return sorted(range(len(stretches)), key=lambda i: (stretches[i].start, i))


def ordered(stretches: Sequence[Stretch], load: Callable[[Stretch], Block]) -> Iterator[Block]:
    """Blocks whose log times never decrease; messages of equal time keep the order of the file.

    Parameters
    ----------
    stretches : sequence of Stretch
        In the order of the file.
    load : callable
        Gives the (chosen) messages of a stretch; called for each once, in the order of `turns`.

    Raises
    ------
    ValueError
        Where log times are so disordered that sorting them would take more than 1 GiB, or where a chunk holds
        messages from before the range that it declares.
    """
    queue = turns(stretches)
    held: list[tuple[int, Block]] = []
    released, loaded = -1, 0
    for turn, number in enumerate(queue):
        block = load(stretches[number])
        if len(block):
            if int(block.log_time.min()) < released:
                raise ValueError(
                    "a chunk holds messages from before its declared start: times cannot be sorted"
                )
            held.append((number, block))
        loaded += len(block.data)
        pending = sum(len(b.data) for _, b in held)
        limit = stretches[queue[turn + 1]].start if turn + 1 < len(queue) else None
        if pending > MAX_PENDING:
            raise ValueError("log times are too disordered: sorting them takes more than 1 GiB")
        if held and (limit is None or loaded >= _TARGET):
            ready, held = _release(held, limit)
            loaded = 0
            if ready is not None:
                released = int(ready.log_time[-1])
                yield ready


def _release(
    held: list[tuple[int, Block]], limit: int | None
) -> tuple[Block | None, list[tuple[int, Block]]]:
    """The held messages from before `limit`, sorted, and those still held; no limit releases all."""
    held = sorted(held, key=lambda item: item[0])
    early = [block if limit is None else block[block.log_time < limit] for _, block in held]
    late = [] if limit is None else [(n, _compact(block[block.log_time >= limit])) for n, block in held]
    joined = _join([block for block in early if len(block)])
    return joined, [(n, block) for n, block in late if len(block)]


def _compact(block: Block) -> Block:
    """The same messages without the rest of their buffer, where that is most of it."""
    if 4 * int(block.size.sum()) > len(block.data):
        return block
    parts = [block.data[o : o + s] for o, s in zip(block.offset.tolist(), block.size.tolist(), strict=True)]
    data = np.concatenate(parts) if parts else block.data[:0].copy()
    return replace(block, data=data, offset=np.cumsum(block.size) - block.size)


def _join(blocks: list[Block]) -> Block | None:
    if not blocks:
        return None
    joined = blocks[0]
    if len(blocks) > 1:
        shifts = np.cumsum([0] + [len(block.data) for block in blocks[:-1]])
        joined = Block(
            np.concatenate([block.data for block in blocks]),
            np.concatenate([block.offset + shift for block, shift in zip(blocks, shifts, strict=True)]),
            *(
                np.concatenate([getattr(block, name) for block in blocks])
                for name in ("size", "channel", "log_time", "publish_time")
            ),
        )
    if (np.diff(joined.log_time) < 0).any():
        joined = joined[np.argsort(joined.log_time, kind="stable")]
    return joined


def chosen(block: Block, channels: Sequence[int] | None, start: int | None, end: int | None) -> Block:
    """The messages of some channels from the time `start` until before `end` [ns]; None does not restrict."""
    keep = np.ones(len(block), bool)
    if channels is not None:
        keep &= block.channel == channels[0] if len(channels) == 1 else np.isin(block.channel, channels)
    if start is not None:
        keep &= block.log_time >= start
    if end is not None:
        keep &= block.log_time < end
    if keep.all():
        return block
    kept = block[keep]
    return kept if len(kept) else replace(kept, data=kept.data[:0])


def runs(block: Block, *, grouped: bool) -> Iterator[Block]:
    """Parts of one channel each: consecutive messages, or with `grouped` all messages of a channel."""
    if grouped:
        _, first = np.unique(block.channel, return_index=True)
        for channel in block.channel[np.sort(first)]:
            yield block[block.channel == channel]
        return
    bounds = np.flatnonzero(np.diff(block.channel)) + 1
    for start, stop in zip([0, *bounds], [*bounds, len(block)], strict=True):
        yield block[start:stop]


def mixed_runs(block: Block, together: Collection[int]) -> Iterator[Block]:
    """Parts of consecutive messages of one channel each, or of any of the channels that go together."""
    key = block.channel
    if len(together) > 1:
        key = np.where(np.isin(key, list(together)), -1, key)
    bounds = (np.flatnonzero(np.diff(key)) + 1).tolist()
    for start, stop in zip([0, *bounds], [*bounds, len(block)], strict=True):
        yield block[start:stop]
