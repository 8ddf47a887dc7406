r"""What the band leaves of the knot intervals of a face, cut into rectangles.

In each trimmed interval the lines of the band's corners make a grid; the rectangle of free cells with the largest area
times squared ratio of sides is taken first, then the next. Hanging nodes do no harm on the surface, where all functions
there are the original B-splines.

Axis letters: r rectangle, d parameter direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from geometry.hybrid.band import Band, oriented
from geometry.hybrid.triangle import make_phi
from geometry.hybrid.trimming import Trimming, xi_at

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Partition:
    """Rectangles outside the band where the face keeps its B-spline surface.

    Attributes
    ----------
    low, high : (r, 2) corners.
    whole : (r,) the rectangle is a whole knot interval.
    """

    low: Array
    high: Array
    whole: NDArray[np.bool_]


def partition(band: Band, knots: tuple[Array, Array], keep: Partition | None = None) -> Partition:
    """Cut what the band leaves of the trimmed knot intervals into rectangles, and list the interior ones whole.

    In each interval the lines of the band's corners make a grid; the rectangle of free cells with the largest area
    times squared ratio of sides is taken, until none is left (greedy: the best partition is NP-hard to find).

    Parameters
    ----------
    keep : a coarser partition; no rectangle then reaches across the border of one of its rectangles.
    """
    old = np.zeros((0, 2, 2)) if keep is None else np.stack([keep.low, keep.high], axis=1)[~keep.whole]
    lines = tuple(np.unique(k) for k in knots)
    phi = make_phi(band.q0, oriented(band))
    boxes = np.concatenate([
        np.stack([phi.min(axis=1), phi.max(axis=1)], axis=1), np.stack([band.low, band.high], axis=1)
    ])
    low, high, whole = [], [], []
    for i in range(len(lines[0]) - 1):
        for j in range(len(lines[1]) - 1):
            corner = np.array([lines[0][i], lines[1][j]])
            end = np.array([lines[0][i + 1], lines[1][j + 1]])
            tiny = 1e-9 * (end - corner)
            mine = ((boxes[:, 0] < end - tiny) & (boxes[:, 1] > corner + tiny)).all(axis=1)
            if not mine.any():
                met = ((old[:, 0] < end - tiny) & (old[:, 1] > corner + tiny)).all(axis=1)
                if _inside(band.trimming, 0.5 * (corner + end)) and not met.any():
                    low.append(corner)
                    high.append(end)
                    whole.append(True)
                    continue
                if not met.any():
                    continue
            for a, b in _greedy(band, boxes[mine], corner, end, old):
                low.append(a)
                high.append(b)
                whole.append(False)
    shape = (-1, 2)
    return Partition(np.array(low).reshape(shape), np.array(high).reshape(shape), np.array(whole, dtype=bool))


def _greedy(band: Band, boxes: Array, corner: Array, end: Array, old: Array) -> list[tuple[Array, Array]]:
    lines = []
    for d in range(2):
        marks = np.concatenate([[corner[d], end[d]], boxes[:, :, d].ravel(), old[:, :, d].ravel()])
        x = np.unique(np.clip(marks, corner[d], end[d]))
        keep = np.concatenate([[True], np.diff(x) > 1e-9 * (end[d] - corner[d])])
        x = x[keep]
        x[-1] = end[d]
        lines.append(x)
    middle = np.stack(np.meshgrid(*(0.5 * (x[1:] + x[:-1]) for x in lines), indexing="ij"), axis=-1)
    covered = ((middle[:, :, None] > boxes[:, 0]) & (middle[:, :, None] < boxes[:, 1])).all(axis=-1).any(axis=-1)
    free = np.array(~covered)
    for i, j in np.argwhere(free):
        free[i, j] = _inside(band.trimming, middle[i, j])
    label = np.full(free.shape, -1)
    for number, (a, b) in enumerate(old):
        label[((middle > a) & (middle < b)).all(axis=-1)] = number
    made = []
    while free.any():
        i0, i1, j0, j1 = _best(free, label, lines[0], lines[1])
        free[i0:i1, j0:j1] = False
        made.append((np.array([lines[0][i0], lines[1][j0]]), np.array([lines[0][i1], lines[1][j1]])))
    return made


@njit(cache=True)
def _best(free: Any, label: Any, x: Any, y: Any) -> Any:
    """Rows and columns of the best rectangle of free cells with one label."""
    best = -1.0
    chosen = (0, 0, 0, 0)
    for i in range(free.shape[0]):
        for j in range(free.shape[1]):
            if not free[i, j]:
                continue
            widest = free.shape[1]
            for k in range(i, free.shape[0]):
                run = j
                while run < widest and free[k, run] and label[k, run] == label[i, j]:
                    run += 1
                if run == j:
                    break
                widest = run
                a, b = x[k + 1] - x[i], y[widest] - y[j]
                score = a * b * (min(a, b) / max(a, b)) ** 2
                if score > best * (1.0 + 1e-12):
                    best, chosen = score, (i, k + 1, j, widest)
    return chosen


def _inside(trimming: Trimming, p: Array) -> bool:
    """Whether a point lies inside the loops: crossings of the ray towards +xi.

    If all loops are holes, what bounds the face is the rectangle of its surface.
    """
    x, y = trimming.plane[:, 0, 0], trimming.plane[:, 0, 1]
    after = trimming.next
    holes = int(float(np.sum(x * y[after] - y * x[after])) < 0.0)
    a, b = trimming.plane[:, 0, 1], trimming.plane[:, 3, 1]
    crossed = np.flatnonzero((a > p[1]) != (b > p[1]))
    beyond = xi_at(trimming.plane, crossed, np.full(len(crossed), p[1])) > p[0]
    return (int(beyond.sum()) + holes) % 2 == 1
