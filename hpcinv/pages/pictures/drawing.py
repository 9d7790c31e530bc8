"""Rendering of triangles without a display (pyvista), and figures of such renderings with text (matplotlib)."""

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.image
import numpy as np
import numpy.typing as npt
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from hpcinv.base.files.names import check_directory_of
from hpcinv.base.quantity.arrays import Floats, Ints
from hpcinv.base.quantity.written_units import as_shown
from hpcinv.errors import OutputError, SystemPartMissing
from hpcinv.output.surfaces.picture import Picture

COLOUR_MAP = "viridis"
_PIXELS = (1000, 800)  # of one view
_MARGIN = 1.2  # of the picture around its frame, for symbols
_IN_A_ROW = 4  # views
_SHARP = 35.0  # degrees between triangles whose common side is drawn


@dataclass(frozen=True)
class DrawnBody:
    """Triangles to draw, in one colour or with values (triangles,) or (points,) on a colour map.

    A translucent body is drawn behind the others, and only its far side, so that it veils no colours.

    Attributes:
        cut: normal (3,) and place of the plane ``normal · x = place`` below which nothing is drawn.
        is_section: whether it is drawn without shades and edges.
    """

    points: Floats
    triangles: Ints
    colour: str = "#d9d9d9"
    values: Floats | None = None
    opacity: float = 1.0
    cut: tuple[Floats, float] | None = None
    is_section: bool = False


@dataclass(frozen=True)
class Glyphs:
    """Symbols at points (n, 3): arrows that end there, or cubes around them.

    Attributes:
        vectors: from tail to tip, (n, 3); left out for cubes.
        size: side of the cubes.
    """

    points: Floats
    colour: str
    vectors: Floats | None = None
    size: float = 0.0


@dataclass(frozen=True)
class View:
    """One rendering: what is drawn, the points that fill it, and from which direction."""

    parts: Sequence[DrawnBody | Glyphs]
    frame: Floats
    direction: Floats
    up: Floats
    title: str = ""


def extent(points: Floats) -> float:
    """Return the diagonal of the bounding box of points."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def directions(points: Floats, up: Floats | None = None) -> tuple[Floats, Floats, Floats]:
    """Return the directions of two views, from above in front and from below behind, and that which is upwards."""
    sizes = np.ptp(points, axis=0)
    up = np.array([0.0, 0.0, 1.0]) if up is None else up / np.linalg.norm(up)
    level = [axis for axis in np.eye(3) if abs(axis @ up) < 0.9][:2]
    wide, deep = sorted(level, key=lambda axis: -(axis @ sizes))
    # With the wide side to the right, x and y have the orientation that readers expect.
    front = np.cross(up, wide)
    front = front if front @ deep else deep
    return 0.45 * wide + front - 0.4 * up, -0.45 * wide - front + 0.4 * up, up


def figure(
    views: Sequence[View],
    title: str,
    *,
    legend: Sequence[tuple[str, str]] = (),
    notes: str = "",
    colours: tuple[str, float, float] | None = None,
    units: Mapping[str, str] | None = None,
) -> Picture:
    """Return a figure with views side by side, and below each other if there are more than four.

    Args:
        legend: texts and their colours.
        notes: lines below the title.
        colours: name of the values on the colour map, and their smallest and largest.
        units: symbols of the units of a scale bar in each view, by SI unit; left out, there is no bar.

    Raises:
        SystemPartMissing: there is no OpenGL on this machine, not even in software.
    """
    limits = None if colours is None else colours[1:]
    images = [_rendered(view, limits) for view in views]
    rows = -(-len(views) // _IN_A_ROW)
    columns = -(-len(views) // rows)
    larger = max(1.0, columns / 2.5)  # a wide figure is shown smaller
    sheet = Figure(figsize=(6.4 * columns, 5.4 * rows + 1.2), dpi=130, layout="constrained")
    axes = sheet.subplots(rows, columns, squeeze=False).ravel()
    for axis in axes:
        axis.set_axis_off()
    for axis, image, view in zip(axes, images, views, strict=False):
        axis.imshow(image)
        axis.set_title(view.title, fontsize=11 * larger)
        if units is not None:
            draw_bar(axis, pixel_size(view), _PIXELS, units)
    sheet.suptitle(title + (f"\n{notes}" if notes else ""), fontsize=12 * larger, x=0.01, ha="left")
    if colours is not None:
        mapped = ScalarMappable(Normalize(*colours[1:]), COLOUR_MAP)
        bar = sheet.colorbar(mapped, ax=axes.tolist(), orientation="horizontal", shrink=0.5, pad=0.02)
        bar.set_label(colours[0], fontsize=10 * larger)
        bar.ax.tick_params(labelsize=10 * larger)
    if legend:
        patches = [Patch(color=colour, label=text) for text, colour in legend]
        sheet.legend(handles=patches, loc="outside lower left", fontsize=9 * larger, frameon=False)
    stream = io.BytesIO()
    with mpl.rc_context({"savefig.facecolor": "white"}):
        sheet.savefig(stream, format="png")
    return Picture(stream.getvalue())


def thumbnail(view: View, limits: tuple[float, float]) -> bytes:
    """Return a small rendering as PNG without a ground, for light and dark pages; raises as `figure` does."""
    stream = io.BytesIO()
    mpl.image.imsave(stream, _rendered(view, limits, transparent=True)[::3, ::3])
    return stream.getvalue()


def _rendered(view: View, limits: tuple[float, float] | None, *, transparent: bool = False) -> npt.NDArray[np.uint8]:
    """Draw a view, its translucent bodies behind the others: within a curved shell they would veil its colours."""
    shadows = [part for part in view.parts if isinstance(part, DrawnBody) and part.opacity < 1]
    if not shadows:
        return _rendered_parts(view, limits, transparent=transparent)
    bodies = [part for part in view.parts if not (isinstance(part, DrawnBody) and part.opacity < 1)]
    behind = _rendered_parts(replace(view, parts=shadows), limits, transparent=transparent)
    front = _rendered_parts(replace(view, parts=bodies), limits, transparent=True)
    cover, channels = front[..., 3:] / 255.0, behind.shape[2]
    above = front[..., :channels].astype(float)
    if channels == 4:  # opacities add up, colours are weighted by them
        below = behind[..., 3:] / 255.0 * (1 - cover)
        total = np.maximum(cover + below, 1e-9)
        mixed = (above * cover + behind * below) / total
        mixed[..., 3:] = 255 * (cover + below)
    else:
        mixed = above * cover + behind * (1 - cover)
    return np.rint(mixed).astype(np.uint8)


def _rendered_parts(view: View, limits: tuple[float, float] | None, *, transparent: bool) -> npt.NDArray[np.uint8]:
    import pyvista as pv
    from vtkmodules.vtkCommonCore import vtkLogger

    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)  # VTK warns of a missing display before it does without
    try:
        plotter: Any = pv.Plotter(off_screen=True, window_size=list(_PIXELS))
    except Exception as error:  # VTK raises nothing narrower
        raise SystemPartMissing(f"no picture can be drawn: {error}", _ADVICE) from error
    plotter.set_background("white")
    for part in view.parts:
        _add(plotter, part, limits)
    plotter.add_axes(line_width=2)
    _aim(plotter, view)
    plotter.enable_anti_aliasing("ssaa")
    image = plotter.screenshot(return_img=True, transparent_background=transparent)
    plotter.close()
    if image is None or image.max() == image.min():
        raise SystemPartMissing("no picture can be drawn: the rendering is empty", _ADVICE)
    return np.asarray(image)


def _placed(view: View) -> tuple[Floats, Floats]:
    """Return the points of the frame to the right, upwards and away, and these directions as rows."""
    direction = view.direction / np.linalg.norm(view.direction)
    right = np.cross(direction, view.up)
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(right, direction), direction])
    return view.frame @ axes.T, axes


def pixel_size(view: View) -> float:
    """Return the length (m) of a pixel in the rendering of a view."""
    return _height(_placed(view)[0]) / _PIXELS[1]


def _height(placed: Floats) -> float:
    """Return the height (m) of a picture that a frame fills."""
    wide, high, _ = np.ptp(placed, axis=0)
    return _MARGIN * float(max(high, wide * _PIXELS[1] / _PIXELS[0]))


def _aim(plotter: Any, view: View) -> None:
    """Let the frame fill the picture, in parallel projection."""
    placed, axes = _placed(view)
    middle = (placed.min(axis=0) + placed.max(axis=0)) / 2
    wide, high, deep = np.ptp(placed, axis=0)
    camera = plotter.camera
    camera.focal_point = middle @ axes
    camera.position = (middle - [0.0, 0.0, 2.0 * (wide + high + deep)]) @ axes
    camera.up = axes[1]
    plotter.enable_parallel_projection()
    camera.parallel_scale = _height(placed) / 2
    plotter.renderer.ResetCameraClippingRange()


_ADVICE = "Install OpenGL in software: on Debian, libegl1 and libgl1-mesa-dri."


def _add(plotter: Any, part: DrawnBody | Glyphs, limits: tuple[float, float] | None) -> None:
    import pyvista as pv

    if isinstance(part, Glyphs):
        plotter.add_mesh(_symbols(part), color=part.colour, ambient=0.3)
        return
    mesh = pv.PolyData.from_regular_faces(part.points, part.triangles)
    look: dict[str, Any] = {"color": part.colour}
    if part.values is not None:
        mesh["values"] = part.values
    if part.cut is not None:
        normal, place = part.cut
        mesh = mesh.clip(normal=normal, origin=normal * place, invert=False)
        if not mesh.n_cells:
            return
    if part.values is not None:
        look = {"scalars": "values", "cmap": COLOUR_MAP, "clim": limits, "show_scalar_bar": False}
    if part.opacity < 1:
        look["culling"] = "front"  # a shadow that is larger than the body would veil the body's colours
    if part.is_section:
        plotter.add_mesh(mesh, lighting=False, **look)
        return
    plotter.add_mesh(mesh, opacity=part.opacity, ambient=0.25, smooth_shading=False, **look)
    sharp = mesh.extract_feature_edges(_SHARP, boundary_edges=True, manifold_edges=False, non_manifold_edges=True)
    if sharp.n_cells:
        plotter.add_mesh(sharp, color="#303030", line_width=1.5, opacity=part.opacity)


def _symbols(glyphs: Glyphs) -> Any:
    import pyvista as pv

    cloud = pv.PolyData(glyphs.points)
    if glyphs.vectors is None:
        return cloud.glyph(geom=pv.Cube(), scale=False, orient=False, factor=glyphs.size)
    lengths = np.linalg.norm(glyphs.vectors, axis=1)
    cloud = pv.PolyData(glyphs.points - glyphs.vectors)
    cloud["vectors"] = glyphs.vectors / np.maximum(lengths, np.finfo(float).tiny)[:, None]
    arrow = pv.Arrow(tip_length=0.35, tip_radius=0.12, shaft_radius=0.04)
    return cloud.glyph(geom=arrow, orient="vectors", scale=False, factor=float(lengths.max(initial=0.0)))


def check_png(path: Path) -> None:
    """Raise ``OutputError`` for a picture that is not a PNG, before it is drawn."""
    if path.suffix.lower() != ".png":
        raise OutputError(f"{path}: pictures are PNG files", f"Name it {path.with_suffix('.png').name}.")
    check_directory_of(path)


_MOST = 0.2
"""share of the width of a rendering; raised, longer bars"""


def round_length(most: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten up to a length."""
    power = 10.0 ** math.floor(math.log10(most))
    return next(times * power for times in (5.0, 2.0, 1.0) if times * power <= most * (1 + 1e-9))


def draw_bar(axis: Any, pixel: float, size: tuple[int, int], symbols: Mapping[str, str]) -> None:
    """Draw a bar with its length in the lower right corner of a rendering.

    Args:
        axis: of Matplotlib, in pixels.
        pixel: length of a pixel in m.
        size: width and height of the rendering in pixels.
        symbols: of the units in which lengths are shown, by SI unit.
    """
    width, height = size
    length = round_length(_MOST * width * pixel)
    right, bottom = 0.97 * width, 0.97 * height
    axis.plot([right - length / pixel, right], [bottom, bottom], color="black", linewidth=2, solid_capstyle="butt")
    axis.text(
        right - length / pixel / 2, bottom - 0.01 * height, as_shown(length, "m", symbols, 3), ha="center", va="bottom"
    )
