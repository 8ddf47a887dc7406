"""Keys of octree cells: ``block * 2^(d l) + z`` at level l, with z the Morton code of the cell's place.

z interleaves the bits of the coordinates, so the parent of key k is k >> d and its children are 2^d k, ..., 2^d k +
2^d - 1: ascending keys run through a tree depth first.

Axis letters: m cell, d dimension.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.int64]


def key_of(block: Index, place: Index, level: int | Index) -> Index:
    """Keys of cells at places (m, d) in units of their size."""
    d = place.shape[1]
    key = np.left_shift(np.asarray(block, dtype=np.int64), d * level)
    for axis in range(d):
        key = key | (_spread(place[:, axis], d) << (d - 1 - axis))
    return key


def place_of(key: Index, level: int, d: int) -> tuple[Index, Index]:
    """Blocks (m,) and places (m, d) of keys."""
    low = key & ((1 << (d * level)) - 1)
    return key >> (d * level), np.stack([_gather(low >> (d - 1 - axis), d) for axis in range(d)], axis=-1)


_MASKS = {
    3: ((8, 0x00F00F00F00F), (4, 0x0C30C30C30C3), (2, 0x249249249249)),
    2: ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)),
}
_WHOLE = {3: 0xFF0000FF, 2: 0xFFFF}


def _spread(x: Index, d: int) -> Index:
    """Put d - 1 zeros between the 16 bits of each number."""
    x = np.asarray(x, dtype=np.int64)
    if d == 3:
        x = (x | (x << 16)) & _WHOLE[3]
    for shift, mask in _MASKS[d]:
        x = (x | (x << shift)) & mask
    return x


def _gather(x: Index, d: int) -> Index:
    """Undo `_spread`, whatever lies in the other bits."""
    masks = _MASKS[d]
    x = x & masks[-1][1]
    for k in range(len(masks) - 1, -1, -1):
        x = (x | (x >> masks[k][0])) & (masks[k - 1][1] if k else _WHOLE[d])
    return (x | (x >> 16)) & 0xFFFF if d == 3 else x


def ancestors(key: Index, level: Index, d: int) -> list[Index]:
    """Keys of all proper ancestors of leaf cells, by level."""
    found: list[Index] = []
    above = np.empty(0, dtype=np.int64)
    for l in range(int(level.max(initial=0)), 0, -1):
        above = np.unique(np.concatenate([above, key[level == l]]) >> d)
        found.append(above)
    return found[::-1]
