"""Compiled parts of `bisection`."""

from __future__ import annotations

import numpy as np
from numba import njit

# mypy: disallow-untyped-defs = False

DONE, SIMPLICES, NODES, LEVEL = 0, 1, 2, 3


@njit(cache=True)
def place_between(nodes, ends, first):
    """Put nodes from number ``first`` on in the middle of their ends."""
    for n in range(first, len(ends)):
        for c in range(nodes.shape[1]):
            nodes[n, c] = 0.5 * (nodes[ends[n, 0], c] + nodes[ends[n, 1], c])


@njit(cache=True)
def slot(keys, a, b):
    """Where edge a b is, or should go, in an open-addressing table whose size is a power of two."""
    key = (min(a, b) << 32) | max(a, b)
    mask = len(keys) - 1
    at = np.int64((np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(24)) & mask
    while keys[at] != -1 and keys[at] != key:
        at = (at + 1) & mask
    return at, key


@njit(cache=True)
def enter(keys, values, ends, first, last):
    """Enter nodes first .. last - 1 into an empty table under the edges that they split."""
    for z in range(first, last):
        at, key = slot(keys, ends[z, 0], ends[z, 1])
        keys[at], values[at] = key, z


@njit(cache=True)
def bisect(tets, tag, block, places, ends, fresh, todo, touched, keys, values, count):
    """Bisect simplices that are to be, or have a split edge, until none is left or there is no room.

    All arrays have room at their ends; ``count`` holds the numbers of simplices and nodes. ``touched`` are the ends of
    split edges. Returns a status; after more room is made the work goes on where it stopped.
    """
    d = tets.shape[1] - 1
    m, n = count[0], count[1]
    status = DONE
    going = True
    while going and status == DONE:
        going = False
        t = 0
        while t < m:
            split = todo[t]
            for i in range(1, d + 1):
                if touched[tets[t, i]] and not split:
                    for j in range(i):
                        if touched[tets[t, j]]:
                            at, key = slot(keys, tets[t, i], tets[t, j])
                            split |= keys[at] == key
            if not split:
                t += 1
                continue
            going = True
            if m == len(tets):
                status = SIMPLICES
                break
            if n == len(ends):
                status = NODES
                break
            k = tag[t]
            a, b = tets[t, 0], tets[t, k]
            at, key = slot(keys, a, b)
            if keys[at] == key:
                z = values[at]
            else:
                z = n
                n += 1
                ends[z, 0], ends[z, 1] = a, b
                touched[a] = touched[b] = True
                keys[at], values[at] = key, z
            # The second child goes to the end, the first one takes the place of its parent.
            for i in range(d + 1):
                source = i + 1 if i < k else i
                tets[m, i] = z if i == k else tets[t, source]
            for c in range(d):
                twice = places[t, 0, c] + places[t, k, c]
                if twice & 1:
                    status = LEVEL
                for i in range(d + 1):
                    source = i + 1 if i < k else i
                    places[m, i, c] = twice >> 1 if i == k else places[t, source, c]
                places[t, k, c] = twice >> 1
            tets[t, k] = z
            tag[t] = tag[m] = k - 1 if k > 1 else d
            block[m] = block[t]
            fresh[t] = fresh[m] = True
            todo[t] = False
            m += 1
    count[0], count[1] = m, n
    return status
