"""Pictures put together: a drawing with its scalar bar, legend and title, in the fonts of the plots.

`STYLE` holds the matplotlib settings of every figure of the project. Matplotlib is loaded when first needed.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iga.exchange.files import replacing

Pixels = NDArray[np.uint8]

STYLE: dict[str, Any] = {
    "figure.facecolor": "white", "savefig.facecolor": "white", "savefig.dpi": 200, "savefig.bbox": "tight",
    "font.family": "serif", "font.serif": ["STIXGeneral", "DejaVu Serif"], "mathtext.fontset": "stix", "font.size": 11,
    "axes.titlesize": 11, "axes.labelsize": 11, "axes.linewidth": 0.8, "axes.axisbelow": True, "legend.fontsize": 9.5,
    "legend.frameon": False, "xtick.direction": "in", "ytick.direction": "in", "xtick.top": True, "ytick.right": True,
    "lines.linewidth": 1.3, "lines.markersize": 5.5, "grid.color": "#dddddd", "grid.linewidth": 0.5,
}  # fmt: skip
DPI = 220
"""Dots of a picture per inch of the frame that is drawn around it."""
LEGEND_ROW, BAR_ROOM = 0.21, 1.5
"""Height in inches of a name in a legend, and of what a scalar bar with its title and ticks needs at least."""


@dataclass(frozen=True)
class Bar:
    """A scalar bar: colour map, range and title."""

    colours: str
    low: float
    high: float
    title: str


def matplotlib() -> Any:
    """Import matplotlib without its noise about a cache folder that it cannot write."""
    if "MPLCONFIGDIR" not in os.environ and not os.access(Path.home(), os.W_OK):
        os.environ["MPLCONFIGDIR"] = tempfile.mkdtemp(prefix="matplotlib-")
    import matplotlib as mpl

    return mpl


def trimmed(picture: Pixels, margin: int = 4) -> Pixels:
    """Cut white borders off a picture (rows, columns, 3), all but a margin."""
    drawn: NDArray[np.bool_] = np.min(picture, axis=-1) < 250
    if not drawn.any():
        return picture
    rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
    top, left = max(rows[0] - margin, 0), max(columns[0] - margin, 0)
    return np.ascontiguousarray(picture[top : rows[-1] + margin + 1, left : columns[-1] + margin + 1])


def compose(
    picture: Pixels,
    path: str | Path | None,
    bar: Bar | None = None,
    legend: Sequence[tuple[str, str]] = (),
    title: str = "",
) -> Pixels:
    """Set a picture (rows, columns, 3) with its scalar bar or legend (name, colour) and title.

    Written as PNG if there is a path, returned in any case.
    """
    mpl = matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows, columns = picture.shape[:2]
    width, drawn = columns / DPI, rows / DPI  # a flat solid is lower than its names
    height = max(drawn, BAR_ROOM if bar is not None else LEGEND_ROW * len(legend))
    with mpl.rc_context({**STYLE, "savefig.bbox": "standard", "font.size": 10}):
        words = [bar.title] if bar is not None else [name for name, _ in legend]
        side = max(0.95 if bar is not None else 0.0, 0.4 + 0.075 * max(map(len, words))) if words else 0.0
        top = 0.3 if title else 0.0
        total = (width + side + 0.16, height + top + 0.16)
        figure = Figure(figsize=total, dpi=DPI)
        canvas = FigureCanvasAgg(figure)
        low = 0.08 + 0.5 * (height - drawn)
        axes = figure.add_axes((0.08 / total[0], low / total[1], width / total[0], drawn / total[1]))
        axes.imshow(picture, interpolation="none", aspect="auto")
        axes.set_axis_off()
        if title:
            figure.text((0.08 + 0.5 * width) / total[0], 1.0 - 0.08 / total[1], title, ha="center", va="top")
        left = width + 0.24
        if bar is not None:
            tall = min(0.72 * height, 2.8)
            place = (left / total[0], (0.08 + 0.46 * (height - tall)) / total[1], 0.12 / total[0], tall / total[1])
            _draw_bar(figure, figure.add_axes(place), bar)
        elif legend:
            from matplotlib.patches import Patch

            patches = [
                Patch(facecolor=colour, edgecolor="none" if colour == "none" else "#2b2b2b", linewidth=0.5, label=name)
                for name, colour in legend
            ]
            figure.legend(
                handles=patches, loc="center left", bbox_to_anchor=((left - 0.1) / total[0], 0.5), handlelength=0.9,
                handleheight=0.9, labelspacing=0.5, borderaxespad=0.0,
            )  # fmt: skip
        canvas.draw()
        made = trimmed(np.asarray(canvas.buffer_rgba())[..., :3].copy(), 16)
    if path is not None:
        from PIL import Image

        with replacing(path) as temporary:
            Image.fromarray(made).save(temporary, format="PNG", optimize=True)
    return made


def _draw_bar(figure: Any, axes: Any, bar: Bar) -> None:
    """Draw a scalar bar into axes of a figure."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    drawn = figure.colorbar(ScalarMappable(Normalize(bar.low, bar.high), bar.colours), cax=axes)
    drawn.locator = MaxNLocator(nbins=6, steps=[1, 2, 2.5, 5, 10])
    form = ScalarFormatter(useMathText=True)
    form.set_powerlimits((-2, 4))
    drawn.formatter = form
    drawn.update_ticks()
    axes.yaxis.get_offset_text().set(ha="left", size=9)
    axes.set_title(bar.title, loc="left", pad=16 if _has_offset(bar) else 8)


def _has_offset(bar: Bar) -> bool:
    """Whether the ticks carry a power of ten above the bar."""
    largest = max(abs(bar.low), abs(bar.high))
    return largest > 0.0 and not 1e-2 <= largest < 1e4
