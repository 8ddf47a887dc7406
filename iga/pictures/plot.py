"""Pictures of domains and of fields on them, drawn off screen.

The skin of a domain (or of what a cut leaves of it) is evaluated exactly on a grid on each facet and drawn with the
exact normals and with the edges of the elements as curves, so a coarse NURBS sphere looks like a sphere.

Drawing needs a graphics library that works without a display (EGL or OSMesa). Where neither is there, VTK would end
the process; so it is tried once in a process of its own, and a one-line error says what to install.

Axis letters: n point or function, c component.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iga.domain import Domain
from iga.errors import InputError
from iga.pictures.picture import Bar, compose, trimmed
from iga.pictures.skin import Cut, Plane, Skin, faces, plane_of, tessellate
from iga.sampling import bounding_box, named_quantities

Array = NDArray[np.float64]

# Paul Tol's light scheme: told apart by everybody, and light enough for dark edges on it; four of his bright and muted
# ones for solids with more boundaries.
COLOURS = (
    "#77AADD", "#EE8866", "#EEDD88", "#FFAABB", "#44BB99", "#99DDFF", "#BBCC33", "#AAAA00", "#CC99BB", "#DDDDDD",
    "#4477AA", "#AA4499", "#228833", "#CC6677",
)  # fmt: skip
EDGE = "#2b2b2b"
LEGEND = 14
"""Most names in a legend, each with a colour of its own."""
VIEWS = {"x": (0.85, 1.0, -1.5), "y": (1.0, 0.85, 1.5), "z": (1.0, -1.5, 0.85)}
"""Axes that point up in a picture, with the direction from the solid to the eye that goes with each."""

# --- pictures --------------------------------------------------------------------------------------------------------


def plot_domain(
    domain: Domain,
    path: str | Path | None = None,
    cut: Cut | str | None = None,
    edges: bool = True,
    names: bool = True,
    title: str = "",
    view: Sequence[float] | None = None,
    up: str = "z",
    size: int = 1000,
) -> NDArray[np.uint8]:
    """Draw a domain: elements as curves, named boundaries in colours.

    Parameters
    ----------
    path : PNG file to write, or None.
    cut : a `Cut`, or just its axis ("x", "-z"), to see inside.
    edges, names : draw the elements' edges; a legend of boundary names (if there is more than one).
    view : direction from the solid to the eye; by default an oblique one, such that a cut faces the eye.
    up : axis that points up in the picture, "x", "y" or "z".
    size : longer side of the solid in pixels.

    Returns
    -------
    The picture (rows, columns, 3).

    Raises
    ------
    InputError : nothing can be drawn on this machine, or the file cannot be written.
    """
    plane = plane_of(domain, cut)
    skin = tessellate(domain, plane=plane)
    parts = list(domain.boundaries)
    palette = {int(n): _part_colour(int(n), len(parts)) for n in np.unique(skin.part)}

    def paint(scene: Any) -> None:
        for number, colour in palette.items():
            _surface(scene, skin, skin.part == number, color=colour)
        if edges:
            _curves(scene, skin)

    picture = _draw(skin, _direction(plane, view, up), _axis(up), size, paint)
    legend = [(parts[n], colour) for n, colour in palette.items() if n >= 0] if names and len(parts) > 1 else []
    if len(legend) > LEGEND:
        legend = [*legend[:LEGEND], (f"and {len(legend) - LEGEND} more", "none")]
    return compose(picture, path, legend=legend, title=title)


def _part_colour(number: int, parts: int) -> str:
    """Colour of a boundary by its number among so many, pale beyond the legend; grey where there is none (-1)."""
    if number < 0:
        return "#d4d4d4"
    if parts == 1:
        return "#a9c5e0"
    colour = COLOURS[number % len(COLOURS)]
    if number < LEGEND:
        return colour
    return "#" + "".join(f"{(int(colour[i : i + 2], 16) + 255) // 2:02x}" for i in (1, 3, 5))


def plot_field(
    domain: Domain,
    values: Any,
    name: str,
    path: str | Path | None = None,
    unit: str = "",
    warp: Any = None,
    scale: float | None = None,
    cut: Cut | str | None = None,
    edges: bool = True,
    limits: tuple[float, float] | None = None,
    colours: str | None = None,
    title: str = "",
    view: Sequence[float] | None = None,
    up: str = "z",
    size: int = 1000,
) -> NDArray[np.uint8]:
    """Draw a field on a domain.

    Parameters
    ----------
    values : coefficients (n,) or (n, c), a `Field`, or a function of `Samples`; of several components the length is
        shown.
    name, unit : title of the scalar bar.
    warp : displacement field (coefficients (n, 3) or `Field`) that moves the solid, or None.
    scale : factor on the displacement; by default 1, or such that the largest displacement is a tenth of the domain's
        size where it would be hard to see or absurd otherwise.
    limits : range of the colours, by default that of the values shown.
    colours : name of a colour map; by default a perceptual sequential one, or a diverging one centred at zero for
        values of both signs.
    cut, edges, title, view, up, size : as in `plot_domain`.

    Returns
    -------
    The picture (rows, columns, 3).

    Raises
    ------
    InputError : as in `plot_domain`, or the field does not fit the domain.
    """
    quantity, space = named_quantities(domain, {name: values})[name]
    plane = plane_of(domain, cut)
    skin = tessellate(domain, quantity, space, plane, _warp(domain, warp, scale))
    heading = f"{name} ({unit})" if unit else name
    bar = _bar(np.asarray(skin.values), heading, limits, colours)

    def paint(scene: Any) -> None:
        _surface(
            scene, skin, slice(None), scalars=skin.values, cmap=bar.colours, clim=(bar.low, bar.high), n_colors=256,
            show_scalar_bar=False, interpolate_before_map=True,
        )  # fmt: skip
        if edges:
            _curves(scene, skin, opacity=0.5)

    picture = _draw(skin, _direction(plane, view, up), _axis(up), size, paint)
    return compose(picture, path, bar, title=title)


def _bar(values: Array, title: str, limits: tuple[float, float] | None, colours: str | None) -> Bar:
    """Scalar bar of values (n,); what is not given is chosen as `plot_field` says."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        raise InputError(f"field {title!r} has no finite value to draw")
    low, high = limits if limits is not None else (float(finite.min()), float(finite.max()))
    if not -np.inf < low <= high < np.inf:
        raise InputError(f"limits of colours are two numbers, the lower one first, not {limits}")
    spread = max(abs(low), abs(high))
    if high - low <= 1e-9 * spread:  # constant up to round-off: show it as one colour, not as noise
        low, high = low - 0.05 * (spread or 1.0), high + 0.05 * (spread or 1.0)
    if colours is None:
        both = low < 0.0 < high and min(-low, high) > 0.1 * spread
        colours = "coolwarm" if both else "viridis"
        if both and limits is None:
            low, high = -spread, spread
    return Bar(colours, low, high, title)


def _warp(domain: Domain, warp: Any, scale: float | None) -> Array | None:
    """Displacement (n, 3) times its factor, which is chosen where it is not given; see `plot_field`."""
    if warp is None:
        return None
    moved, space = named_quantities(domain, {"warp": warp})["warp"]
    if not isinstance(moved, np.ndarray) or moved.ndim != 2 or moved.shape[1] != 3:
        raise InputError("a displacement has three coefficients for each function")
    if space is not domain.space and len(moved) != domain.space.n:
        raise InputError("a displacement must be given in the domain's own functions")
    if scale is None:
        largest = float(np.linalg.norm(moved, axis=1).max())
        share = largest / float(np.ptp(bounding_box(domain), axis=0).max())
        scale = 1.0 if 0.03 <= share <= 0.3 or largest == 0.0 else 0.1 / share
    return moved * scale


# --- drawing ---------------------------------------------------------------------------------------------------------

_TRY = """
from vtkmodules.vtkRenderingCore import vtkRenderWindow, vtkRenderer
import vtkmodules.vtkRenderingOpenGL2
window = vtkRenderWindow()
window.SetOffScreenRendering(1)
window.AddRenderer(vtkRenderer())
window.SetSize(8, 8)
window.Render()
raise SystemExit(0 if window.SupportsOpenGL() else 3)
"""


@cache
def window_kind() -> str:
    """Name of the VTK window class that draws on this machine without a display; "" if none does.

    Each is tried in a process of its own, because VTK ends the process where there is no graphics library.
    """
    told = os.environ.get("VTK_DEFAULT_OPENGL_WINDOW", "")
    for kind in [told] if told else ["vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow"]:
        try:
            tried = subprocess.run(
                [sys.executable, "-c", _TRY], env={**os.environ, "VTK_DEFAULT_OPENGL_WINDOW": kind}, timeout=120,
                capture_output=True, check=False,
            )  # fmt: skip
        except (OSError, subprocess.TimeoutExpired):
            continue
        if tried.returncode == 0:
            return kind
    return ""


def can_draw() -> bool:
    """Whether pictures can be drawn on this machine."""
    return bool(window_kind())


def _scene(size: tuple[int, int]) -> Any:
    """Empty picture of so many pixels with its lights.

    Raises
    ------
    InputError : this machine has no graphics library.
    """
    kind = window_kind()
    if not kind:
        raise InputError("no picture can be drawn here: install libegl1 and libegl-mesa0, or libosmesa6, and try again")
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", kind)
    import pyvista as pv

    scene: Any = pv.Plotter(off_screen=True, window_size=list(size), lighting="none")
    scene.set_background("white")
    # Key light over the eye's left shoulder, fill from below and the right, so that no side of a solid is black.
    for position, strength in (((-0.5, 0.8, 1.1), 0.7), ((1.3, -0.4, 0.8), 0.4), ((-0.2, -1.0, 0.7), 0.25)):
        light = pv.Light(position=position, focal_point=(0, 0, 0), intensity=strength, light_type="camera light")
        scene.add_light(light)
    scene.enable_anti_aliasing("ssaa")
    return scene


def _surface(scene: Any, skin: Skin, which: Any, **look: Any) -> None:
    """Draw some triangles of a skin; ``look`` goes to PyVista."""
    import pyvista as pv

    mesh = pv.PolyData(skin.points, faces(skin.triangles[which]))
    mesh.point_data["Normals"] = skin.normals
    mesh.GetPointData().SetActiveNormals("Normals")
    # Colours that stand for numbers are shaded less, so that they can be read off the bar.
    ambient, diffuse = (0.52, 0.52) if "scalars" in look else (0.4, 0.68)
    actor = scene.add_mesh(mesh, ambient=ambient, diffuse=diffuse, specular=0.05, specular_power=20, **look)
    actor.prop.interpolation = "Gouraud"


def _curves(scene: Any, skin: Skin, opacity: float = 0.9) -> None:
    """Edges of the elements, drawn a little nearer to the eye than the surface they lie on."""
    import pyvista as pv

    lines = [line for line in skin.lines if len(line)]
    count = sum(len(line) for line in lines)
    if not count:
        return
    flat, cells, start = [], [], 0
    for line in lines:
        k, m, _ = line.shape
        flat.append(line.reshape(-1, 3))
        cells.append(np.column_stack([np.full(k, m), start + np.arange(k * m).reshape(k, m)]).ravel())
        start += k * m
    curves = pv.PolyData()
    curves.points = np.concatenate(flat)
    curves.lines = np.concatenate(cells)
    width = float(np.clip(2.8 - 0.5 * np.log10(max(count / 100.0, 1.0)), 0.8, 2.8))
    actor = scene.add_mesh(curves, color=EDGE, line_width=width, opacity=opacity, lighting=False)
    actor.mapper.SetResolveCoincidentTopologyToPolygonOffset()
    actor.mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0.0, -8.0)


def _axis(up: str) -> Array:
    """Unit vector of the axis x, y or z."""
    if up not in VIEWS:
        raise InputError(f"up is x, y or z, not {up!r}")
    return np.eye(3)["xyz".index(up)]


def _direction(plane: Plane | None, view: Sequence[float] | None, up: str) -> Array:
    """Unit vector from the solid to the eye: as told, or such that a cut faces the eye."""
    axis = _axis(up)
    if view is not None:
        direction = np.asarray(view, dtype=float)
        if direction.shape != (3,) or not 0.0 < np.linalg.norm(direction) < np.inf:
            raise InputError(f"a view is three numbers, not all zero: {view!r}")
    elif plane is None:
        direction = np.array(VIEWS[up])
    else:
        steep = abs(plane.normal @ axis) >= 0.9
        side = np.cross(np.eye(3)[int(np.argmin(np.abs(plane.normal)))] if steep else axis, plane.normal)
        over = np.array(VIEWS[up]) / np.linalg.norm(VIEWS[up]) if steep else axis
        direction = plane.normal + 0.5 * side / np.linalg.norm(side) + 0.45 * over
    return direction / np.linalg.norm(direction)


def _frame(points: Array, direction: Array, axis: Array) -> tuple[Array, Array]:
    """Upward vector of the picture, and the box [[left, low], [right, high]] of the points in its plane."""
    right = np.cross(axis if abs(direction @ axis) < 0.98 else np.roll(axis, -1), direction)
    right /= np.linalg.norm(right)
    up = np.cross(direction, right)
    flat = points @ np.column_stack([right, up])
    return up, np.array([flat.min(axis=0), flat.max(axis=0)])


def _draw(
    skin: Skin, direction: Array, axis: Array, size: int, paint: Callable[[Any], None]
) -> NDArray[np.uint8]:
    """Draw in parallel projection so that the longer side of the picture is about `size` pixels."""
    if size < 1:
        raise InputError(f"a picture is at least one pixel long, not {size}")
    up, box = _frame(skin.points, direction, axis)
    extent = np.maximum(box[1] - box[0], 1e-3 * np.ptp(box, axis=0).max() + 1e-300)
    pixels = np.maximum(np.ceil(size * extent / extent.max()), size // 4).astype(int) + 24
    scene = _scene((int(pixels[0]), int(pixels[1])))
    paint(scene)
    right = np.cross(up, direction)
    depth = skin.points @ direction
    centre = right * box[:, 0].mean() + up * box[:, 1].mean() + direction * 0.5 * (depth.min() + depth.max())
    reach = float(np.linalg.norm(np.ptp(skin.points, axis=0))) or 1.0
    camera = scene.camera
    camera.parallel_projection = True
    camera.focal_point = centre
    camera.position = centre + 2.0 * reach * direction
    camera.up = up
    camera.parallel_scale = 0.5 * max(extent[1] / (pixels[1] - 24), extent[0] / (pixels[0] - 24)) * pixels[1]
    camera.clipping_range = (0.5 * reach, 3.5 * reach)
    picture = np.asarray(scene.screenshot(None, return_img=True))[..., :3]
    scene.close()
    return trimmed(picture)
