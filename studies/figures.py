"""Figures of studies: convergence plots with slope triangles, bars, and tables as heat maps.

Matplotlib is loaded when the first figure is drawn (it takes seconds) and draws into files only.
Colours are those of Okabe and Ito, told apart by everybody; markers repeat the distinction for print in black.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iga.exchange.files import replacing
from iga.pictures.picture import STYLE, matplotlib

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#5b5b5b", "#8c6d31")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "h")


@dataclass(frozen=True)
class Series:
    """One curve of a convergence plot: x (k,) against y (k,), positive.

    `rate` is the exponent drawn as a slope triangle under the last pair of points; None draws no triangle. Series of
    equal `family` share a colour, and `dashed` sets two of one family apart.
    """

    label: str
    x: Sequence[float] | NDArray[np.float64]
    y: Sequence[float] | NDArray[np.float64]
    rate: float | None = None
    family: int | None = None
    dashed: bool = False


@contextmanager
def drawing(path: str | Path, rows: int = 1, columns: int = 1, size: tuple[float, float] = (4.6, 3.8)) -> Iterator[Any]:
    """Yield matplotlib axes (an array of them if there are several) and save the figure, whole or not at all.

    The format follows the suffix of `path`: png, svg or pdf. `size` is that of one panel, in inches.
    """
    mpl = matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(size[0] * columns, size[1] * rows), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(rows, columns)
        yield axes
        with replacing(path) as temporary:
            figure.savefig(temporary)


def convergence(
    axes: Any, series: Sequence[Series], x_label: str, y_label: str, title: str = "", legend: bool = True
) -> None:
    """Draw curves on doubly logarithmic axes, with a triangle of the stated slope at the fine end of each.

    Curves without points are left out. A legend of more than six curves stands beside the axes.
    """
    axes.set_xscale("log")
    axes.set_yscale("log")
    series = [one for one in series if len(one.x)]
    families: dict[Any, int] = {}
    for one in series:
        number = families.setdefault(one.label if one.family is None else one.family, len(families))
        axes.plot(
            one.x, one.y, color=COLOURS[number % len(COLOURS)], marker=MARKERS[number % len(MARKERS)],
            linestyle="--" if one.dashed else "-", markerfacecolor="white" if one.dashed else None, label=one.label,
        )  # fmt: skip
    axes.grid(True, which="major")
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    if title:
        axes.set_title(title)
    axes.margins(x=0.12, y=0.1)
    if not series:
        return
    _tick_levels(axes, np.unique(np.concatenate([np.asarray(one.x, dtype=float) for one in series])))
    drawn: list[tuple[float, float]] = []
    for one in series:
        if one.rate is not None and len(one.x) >= 2:
            _triangle(axes, one, one.rate, drawn)
    if legend and len(series) > 6:
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, handlelength=1.9)
    elif legend:
        axes.legend(loc="best", handlelength=1.9, labelspacing=0.35)


def _tick_levels(axes: Any, levels: np.ndarray) -> None:
    """Put the ticks of a short x axis at the levels themselves: decades alone would leave one or two."""
    from matplotlib.ticker import NullFormatter, NullLocator

    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())
    if len(levels) > 6 or levels[-1] > 100.0 * levels[0]:
        return
    axes.set_xticks(levels, [_short(level) for level in levels])
    axes.xaxis.set_minor_locator(NullLocator())


def _short(value: float) -> str:
    """Return 1/8 for 0.125, 2/3 for 0.6667, and few digits where there is no such fraction."""
    fraction = Fraction(value).limit_denominator(6 if value > 0.5 else 4096)
    exact = abs(float(fraction) - value) < 1e-3 * abs(value)
    if exact and (fraction.numerator == 1 or fraction.denominator <= 6):
        return str(fraction)
    return f"{value:.3g}"


def _triangle(axes: Any, one: Series, rate: float, drawn: list[tuple[float, float]]) -> None:
    """Draw a right triangle of slope ``rate`` just under the last pair of points, and add its place to ``drawn``."""
    x1, x2 = np.log10(one.x[-1]), np.log10(one.x[-2])  # the fine end first
    y1 = np.log10(one.y[-1])
    width = 0.45 * (x2 - x1)
    left = x1 + 0.25 * (x2 - x1)
    # Under the curve where it is above its own chord start, by a constant share of the axis height.
    bottom, top = np.log10(axes.get_ylim())
    gap = 0.035 * (top - bottom)
    slope = (np.log10(one.y[-2]) - y1) / (x2 - x1)
    low = y1 + slope * (left - x1) - gap - max(0.0, (rate - slope) * width)
    for other_left, other_low in drawn:
        if abs(other_left - left) < abs(width) and abs(other_low - low) < 1.2 * gap:
            return  # another triangle of about the same place says enough
    drawn.append((left, low))
    right, high = left + width, low + rate * width
    corners = np.array([[left, low], [right, low], [right, high], [left, low]])
    axes.plot(*10.0**corners.T, color="#444444", linewidth=0.8, marker="")
    grey = {"color": "#444444", "fontsize": 8.5}
    forward = width > 0
    axes.annotate(
        "1", 10.0 ** np.array([left + 0.5 * width, low]), (0, -2), textcoords="offset points", ha="center",
        va="top" if high > low else "bottom", **grey,
    )  # fmt: skip
    axes.annotate(
        _short(abs(rate)), 10.0 ** np.array([right, 0.5 * (low + high)]), (3 if forward else -3, 0),
        textcoords="offset points", ha="left" if forward else "right", va="center", **grey,
    )  # fmt: skip


def plot_heat_table(
    path: str | Path,
    rows: Sequence[str],
    columns: Sequence[str],
    values: np.ndarray,
    title: str = "",
    form: str = ".1e",
    log: bool = True,
) -> None:
    """Draw a table of numbers (r, c) whose cells are shaded by size; cells that are not finite stay empty."""
    from matplotlib.colors import LogNorm

    with drawing(path, size=(1.6 + 0.78 * len(columns), 0.9 + 0.34 * len(rows))) as axes:
        shown = np.ma.masked_invalid(np.where(values > 0, values, np.nan) if log else values)
        norm = LogNorm() if log else None
        image = axes.imshow(shown, cmap="viridis", norm=norm, aspect="auto", alpha=0.85)
        axes.set_xticks(range(len(columns)), columns)
        axes.set_yticks(range(len(rows)), rows)
        axes.tick_params(length=0, top=False, right=False)
        for i, j in np.ndindex(*values.shape):
            if np.isfinite(values[i, j]):
                light = bool(np.ma.getmaskarray(shown)[i, j]) or image.norm(values[i, j]) > 0.55
                text = format(values[i, j], form)
                axes.text(j, i, text, ha="center", va="center", fontsize=8.5, color="black" if light else "white")
        if title:
            axes.set_title(title)


def plot_panels(path: str | Path, panels: Sequence[tuple[str, NDArray[np.uint8]]], columns: int) -> None:
    """Set rendered pictures (rows, columns, 3) with their titles side by side, row by row."""
    rows = -(-len(panels) // columns)
    with drawing(path, rows, columns, size=(3.0, 3.0)) as axes:
        for place in np.atleast_1d(axes).ravel():
            place.axis("off")
        for place, (title, picture) in zip(np.atleast_1d(axes).ravel(), panels):
            place.imshow(picture)
            place.set_title(title, fontsize=9)
