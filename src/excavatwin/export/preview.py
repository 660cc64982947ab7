"""``preview.png``: one photo, the classes found in it, and the relief of the map, at a glance."""

from __future__ import annotations

import io
from dataclasses import dataclass

import cmcrameri.cm
import numpy as np
from jaxtyping import UInt8
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon, Rectangle
from matplotlib.ticker import MaxNLocator

from excavatwin.export.placement import origin_of
from excavatwin.export.relief import elevation_limits, relief, window
from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.site import MappedView, Site
from excavatwin.scene.taxonomy import NOT_OBSERVED, PALETTE, TASK_CLASSES, TaskClass

_WIDTH, _DPI = 12.0, 150  # inches, dots per inch
_GAP, _HEAD, _FOOT = 0.12, 0.34, 0.62  # inches between panels, above them (titles), below them (legend)
_INK = "#222222"
_HALO = [patheffects.withStroke(linewidth=2.5, foreground="white")]


def encode_preview(site: Site) -> bytes:
    """PNG bytes, 1800 px wide."""
    view = best_view(site)
    rows, cols = window(site.map)
    map_aspect = float(np.clip((cols.stop - cols.start) / (rows.stop - rows.start), 0.6, 2.2))
    panels = _Panels.around(view, map_aspect)
    figure = Figure(figsize=(_WIDTH, panels.height), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    axes = [_axes(figure, box, panels.height) for box in panels.boxes]
    if view is not None:
        if view.image is not None:
            _picture(axes.pop(0), view.image, view.name)
        _picture(axes.pop(0), overlay(view), "what every pixel turned out to be")
    limits = elevation_limits(site.map.elevation)
    _map(axes[0], site.map, limits)
    _legend(figure, site, limits, panels.height)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": "ExcavaTwin"})
    return stream.getvalue()


def best_view(site: Site) -> MappedView | None:
    """The photo that shows most: many classes first, then many known pixels; photos with an image before others."""

    def worth(view: MappedView) -> tuple[bool, float]:
        share = np.bincount(view.label.ravel(), minlength=256)[: len(TaskClass)] / max(view.label.size, 1)
        classes = int((share[1:] > 0.003).sum()) + 0.5 * (share[TaskClass.EXCAVATOR] > 0.003)
        return view.image is not None, classes + float(share[1:].sum()) + 4 * float(share[TaskClass.EXCAVATOR])

    return max(site.views, key=worth, default=None)


def overlay(view: MappedView) -> UInt8[np.ndarray, "H W 3"]:
    """Class colours over the photo in grey; where nothing is known of a pixel, the photo alone, paler."""
    colours = np.zeros((256, 3))
    for k, rgb in PALETTE.items():
        colours[int(k)] = rgb
    tint = colours[view.label]
    if view.image is None:
        return tint.astype(np.uint8)
    grey = (view.image @ np.array([0.299, 0.587, 0.114]))[..., None]
    mixed = 0.2 * grey + 0.8 * tint * (0.65 + 0.55 * grey / 255)
    pale = 0.45 * grey + 0.55 * 255
    nothing = (view.label == NOT_OBSERVED)[..., None]
    return np.clip(np.where(nothing, pale, mixed), 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class _Panels:
    """Boxes (left, bottom, width, height) [inches]: pictures first, the map last."""

    boxes: list[tuple[float, float, float, float]]
    height: float

    @staticmethod
    def around(view: MappedView | None, map_aspect: float) -> _Panels:
        """Landscape photos are stacked left of the map; upright ones stand beside it."""
        count = 0 if view is None else 2 if view.image is not None else 1
        inner = _WIDTH - 2 * _GAP
        if view is None:
            h = inner / map_aspect
            return _Panels([(_GAP, _FOOT, inner, h)], h + _HEAD + _FOOT)
        a = view.label.shape[1] / view.label.shape[0]
        if a >= 1 and count == 2:  # two pictures of height p, one map of height 2 p + gap
            p = (inner - _GAP - map_aspect * _HEAD) / (a + 2 * map_aspect)
            h = 2 * p + _HEAD
            left = [(_GAP, _FOOT + p + _HEAD, a * p, p), (_GAP, _FOOT, a * p, p)]
            return _Panels([*left, (2 * _GAP + a * p, _FOOT, map_aspect * h, h)], h + _HEAD + _FOOT)
        h = (inner - count * _GAP) / (count * a + map_aspect)
        boxes = [(_GAP + i * (a * h + _GAP), _FOOT, a * h, h) for i in range(count)]
        return _Panels([*boxes, (_WIDTH - _GAP - map_aspect * h, _FOOT, map_aspect * h, h)], h + _HEAD + _FOOT)


def _axes(figure: Figure, box: tuple[float, float, float, float], height: float) -> Axes:
    left, bottom, w, h = box
    axes = figure.add_axes((left / _WIDTH, bottom / height, w / _WIDTH, h / height))
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    return axes


def _title(axes: Axes, text: str) -> None:
    axes.set_title(text, loc="left", fontsize=9, color=_INK, pad=4)


def _picture(axes: Axes, image: UInt8[np.ndarray, "H W 3"], title: str) -> None:
    axes.imshow(image, interpolation="lanczos", aspect="equal")
    _title(axes, title)


def _map(axes: Axes, m: ElevationMap, limits: tuple[float, float]) -> None:
    """Relief, outlines of the objects, scale bar, and a north arrow where north is known."""
    grid, (rows, cols) = m.grid, window(m)
    x0, x1 = grid.west + cols.start * grid.cell, grid.west + cols.stop * grid.cell
    y0, y1 = grid.north - rows.stop * grid.cell, grid.north - rows.start * grid.cell
    axes.set_facecolor("#f3f2ef")
    axes.imshow(relief(m, limits)[rows, cols], extent=(x0, x1, y0, y1), interpolation="antialiased")
    for o in m.objects:
        for width, edge in ((3.2, "white"), (1.6, _colour(o.task_class))):
            axes.add_patch(Polygon(o.footprint, closed=True, fill=False, edgecolor=edge, linewidth=width, zorder=3))
        x, y = o.footprint.mean(0)
        axes.text(
            x, y, str(o.object_id), fontsize=7, color=_INK, ha="center", va="center", path_effects=_HALO, zorder=4
        ).set_clip_on(True)
    axes.set_aspect("equal", adjustable="box", anchor="C")
    pad_x, pad_y = _padding(axes, x1 - x0, y1 - y0)
    axes.set_xlim(x0 - pad_x, x1 + pad_x)
    axes.set_ylim(y0 - pad_y, y1 + pad_y)
    _title(axes, "terrain elevation, objects outlined")
    scale_bar(axes, m.unit)
    if m.georeference is not None:
        arrow = {"arrowstyle": "-|>", "color": _INK, "lw": 1.6, "path_effects": _HALO}
        axes.annotate(
            "N", (0.955, 0.97), (0.955, 0.87), "axes fraction", ha="center", va="center", fontsize=10, color=_INK,
            weight="bold", arrowprops=arrow, path_effects=_HALO,
        )  # fmt: skip


def _colour(k: int) -> tuple[float, float, float]:
    r, g, b = PALETTE[k]
    return r / 255, g / 255, b / 255


def _padding(axes: Axes, width: float, height: float) -> tuple[float, float]:
    """What to add on both sides so that the map fills its panel without being stretched."""
    box = axes.get_position(original=True)
    figure_width, figure_height = axes.get_figure(root=True).get_size_inches()  # type: ignore[union-attr]
    aspect = (box.width * figure_width) / (box.height * figure_height)
    return max(0.0, (height * aspect - width) / 2), max(0.0, (width / aspect - height) / 2)


def scale_bar(axes: Axes, unit: str) -> None:
    """A bar of 1, 2 or 5 times a power of ten, about a fifth of the panel."""
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    wanted = 0.22 * (x1 - x0)
    power = 10.0 ** np.floor(np.log10(wanted))
    length = max(step * power for step in (1, 2, 5) if step * power <= wanted)
    x, y, thick = x0 + 0.03 * (x1 - x0), y0 + 0.03 * (y1 - y0), 0.008 * (y1 - y0)
    axes.add_patch(
        Rectangle((x - thick, y - thick), length + 2 * thick, 3 * thick, facecolor="white", alpha=0.9, zorder=5)
    )
    axes.add_patch(Rectangle((x, y), length, thick, facecolor=_INK, edgecolor="none", zorder=6))
    text = f"{length:g} {unit if unit == 'm' else 'units (scale unknown)'}"
    axes.text(x, y + 2.6 * thick, text, fontsize=8.5, color=_INK, va="bottom", path_effects=_HALO, zorder=6)


def _legend(figure: Figure, site: Site, limits: tuple[float, float], height: float) -> None:
    """Class swatches on the left, elevation colours on the right, the facts of the map between."""
    m = site.map
    shown = (*TASK_CLASSES, TaskClass.UNKNOWN)
    handles = [Patch(color=_colour(k), label=k.name.replace("_", " ").lower()) for k in shown]
    figure.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(_GAP / _WIDTH, 0.26 / height),
        bbox_transform=figure.transFigure,
        ncols=len(handles), frameon=False, fontsize=8, handlelength=1.1, handleheight=1.1, columnspacing=1.1,
        borderaxespad=0, borderpad=0.1, labelcolor=_INK,
    )  # fmt: skip
    figure.text(_GAP / _WIDTH, 0.09 / height, facts(site), fontsize=8, color="#555555")
    bar = figure.add_axes(((_WIDTH - 2 * _GAP - 3.0) / _WIDTH, 0.36 / height, 3.0 / _WIDTH, 0.11 / height))
    z = origin_of(m)[2]
    colours = ScalarMappable(Normalize(limits[0] + z, limits[1] + z), cmcrameri.cm.batlow)
    colourbar = figure.colorbar(colours, cax=bar, orientation="horizontal")
    colourbar.outline.set_visible(False)
    colourbar.locator = MaxNLocator(6)
    colourbar.ax.tick_params(labelsize=7.5, length=2, color=_INK, labelcolor=_INK, pad=1.5)
    unit = "m" if m.metric else "unit"
    bar.text(
        -0.02, 0.5, f"elevation [{unit}]", fontsize=8, ha="right", va="center", transform=bar.transAxes, color=_INK
    )


def facts(site: Site) -> str:
    """Photos, extent, cell, objects and place in one line."""
    m = site.map
    rows, cols = window(m)
    w, h = (cols.stop - cols.start) * m.grid.cell, (rows.stop - rows.start) * m.grid.cell
    cell = f"{100 * m.grid.cell:.3g} cm" if m.metric and m.grid.cell < 1 else f"{m.grid.cell:.3g} {m.unit}"
    parts = [
        f"{len(site.views)} photo{'s' if len(site.views) != 1 else ''}",
        f"{w:.3g} × {h:.3g} {m.unit}",
        f"cell {cell}",
        f"{len(m.objects)} object{'s' if len(m.objects) != 1 else ''}",
        f"EPSG:{m.georeference.epsg}" if m.georeference else "local frame",
    ]
    return "  ·  ".join(parts)
