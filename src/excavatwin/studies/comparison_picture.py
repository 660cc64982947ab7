"""``comparison.png``: A's classes, B's classes, and B's height minus A's, all on A's grid over shaded relief."""

from __future__ import annotations

import io
from dataclasses import dataclass

import cmcrameri.cm
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from excavatwin.evaluation.comparison import Comparison
from excavatwin.evaluation.comparison_grid import Layers
from excavatwin.export.preview import scale_bar
from excavatwin.export.relief import hillshade
from excavatwin.scene.taxonomy import NOT_OBSERVED, PALETTE, TASK_CLASSES, TaskClass

_WIDTH, _DPI = 13.0, 150  # inches, dots per inch
_GAP, _HEAD, _FOOT = 0.14, 0.5, 0.78  # inches between panels, above them (titles), below them (legend)
_WIDE = 1.9
"""Maps wider than this many times their height are stacked, not put side by side."""
_INK, _PAPER, _GREY = "#222222", "#f3f2ef", 0.78
_MOST = 1800
"""Cells along the longer side of a panel: more are thinned out, as no dot would show them."""
_TAIL = 98.0
"""Per cent of the differences within the colours; what is beyond has the last colour."""
_STEPS = 10.0 ** np.arange(-6, 7)[:, None] * np.array([1.0, 2.0, 5.0])


def encode_comparison(c: Comparison) -> bytes:
    """PNG bytes, 1950 px wide."""
    rows, cols = _window(np.asarray(c.layers_a.observed | c.layers_b.observed))
    aspect = float(np.clip((cols.stop - cols.start) / (rows.stop - rows.start), 0.5, 4.0))
    layout = _Layout.of(aspect)
    figure = Figure(figsize=(_WIDTH, layout.height), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    extent = (
        c.grid.west + cols.start * c.grid.cell, c.grid.west + cols.stop * c.grid.cell,
        c.grid.north - rows.stop * c.grid.cell, c.grid.north - rows.start * c.grid.cell,
    )  # fmt: skip
    thin = max(1, -(-max(rows.stop - rows.start, cols.stop - cols.start) // _MOST))
    at = (slice(rows.start, rows.stop, thin), slice(cols.start, cols.stop, thin))
    limit = colour_limit(c.difference)
    pictures = (
        (classes(c.layers_a, at, thin * c.grid.cell), f"A: {c.a.folder.name}", c.a.backbones),
        (classes(c.layers_b, at, thin * c.grid.cell), f"B: {c.b.folder.name}", c.b.backbones),
        (signed(c, at, thin * c.grid.cell, limit), "terrain height, B minus A", _spread(c)),
    )
    for box, (image, title, below) in zip(layout.boxes, pictures, strict=True):
        axes = _axes(figure, box, layout.height)
        axes.imshow(image, extent=extent, interpolation="antialiased", aspect="equal")
        _fill(axes, extent, box)
        axes.set_title(f"{title}\n", loc="left", fontsize=10, color=_INK, pad=3)
        axes.annotate(
            below, (0, 1), (0, 3.5), "axes fraction", "offset points", fontsize=8, color="#555555", va="bottom"
        )
        scale_bar(axes, c.unit)
    _legend(figure, c, limit, layout.height)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": "ExcavaTwin"})
    return stream.getvalue()


@dataclass(frozen=True)
class _Layout:
    """Boxes (left, bottom, width, height) [inches] of the three panels."""

    boxes: list[tuple[float, float, float, float]]
    height: float

    @staticmethod
    def of(aspect: float) -> _Layout:
        inner = _WIDTH - 2 * _GAP
        if aspect <= _WIDE:
            w = (inner - 2 * _GAP) / 3
            h = w / aspect
            return _Layout([(_GAP + k * (w + _GAP), _FOOT, w, h) for k in range(3)], h + _HEAD + _FOOT)
        h = inner / aspect
        bottoms = [_FOOT + k * (h + _HEAD) for k in (2, 1, 0)]
        return _Layout([(_GAP, bottom, inner, h) for bottom in bottoms], 3 * (h + _HEAD) + _FOOT)


def colour_limit(difference: Float32[np.ndarray, "Y X"]) -> float:
    """End of the colours on both sides of zero: a round number that holds most differences [unit of the map]."""
    known = np.abs(difference[np.isfinite(difference)])
    reach = float(np.percentile(known, _TAIL)) if known.size else 0.0
    return float(_STEPS[reach <= _STEPS].min()) if 0 < reach <= _STEPS.max() else float(_STEPS.min())


def classes(side: Layers, at: tuple[slice, slice], cell: float) -> Float64[np.ndarray, "y x 4"]:
    """Class colours over the relief of the map's own terrain; transparent where nothing is observed."""
    label = side.label[at]
    return _lit(_palette()[label] / 255, side.elevation[at], cell, label != NOT_OBSERVED)


def signed(c: Comparison, at: tuple[slice, slice], cell: float, limit: float) -> Float64[np.ndarray, "y x 4"]:
    """The difference over A's relief, red where B is higher; grey where it is not known, transparent outside both."""
    d = c.difference[at]
    known = np.isfinite(d)
    colour = cmcrameri.cm.vik(0.5 + 0.5 * np.clip(np.where(known, d, 0) / limit, -1, 1))[..., :3]
    rgb = np.where(known[..., None], colour, _GREY)
    seen = (c.layers_a.observed | c.layers_b.observed)[at]
    surface = np.where(np.isfinite(c.layers_a.elevation[at]), c.layers_a.elevation[at], c.layers_b.elevation[at])
    return _lit(rgb, surface, cell, seen)


def _palette() -> UInt8[np.ndarray, "256 3"]:
    colours = np.full((256, 3), 128, np.uint8)
    for k, rgb in PALETTE.items():
        colours[int(k)] = rgb
    return colours


def _lit(
    rgb: Float64[np.ndarray, "y x 3"], z: Float32[np.ndarray, "y x"], cell: float, seen: Bool[np.ndarray, "y x"]
) -> Float64[np.ndarray, "y x 4"]:
    light = 0.45 + 0.78 * hillshade(z, cell)
    return np.concatenate([np.clip(rgb * light[..., None], 0, 1), seen[..., None].astype(float)], axis=-1)


def _colour(k: int) -> tuple[float, float, float]:
    r, g, b = PALETTE[k]
    return r / 255, g / 255, b / 255


def _window(seen: Bool[np.ndarray, "Y X"]) -> tuple[slice, slice]:
    """Rows and columns that one of the maps observes, with a small margin."""

    def span(occupied: Bool[np.ndarray, "n"]) -> slice:
        index = np.flatnonzero(occupied)
        margin = max(1, round(0.02 * (index[-1] - index[0])))
        return slice(max(int(index[0]) - margin, 0), min(int(index[-1]) + margin + 1, len(occupied)))

    return span(np.asarray(seen.any(1))), span(np.asarray(seen.any(0)))


def _axes(figure: Figure, box: tuple[float, float, float, float], height: float) -> Axes:
    left, bottom, w, h = box
    axes = figure.add_axes((left / _WIDTH, bottom / height, w / _WIDTH, h / height))
    axes.set_facecolor(_PAPER)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    return axes


def _fill(axes: Axes, extent: tuple[float, float, float, float], box: tuple[float, float, float, float]) -> None:
    """Limits that fill the panel with paper around the map instead of stretching it."""
    x0, x1, y0, y1 = extent
    aspect = box[2] / box[3]
    pad_x, pad_y = max(0.0, ((y1 - y0) * aspect - (x1 - x0)) / 2), max(0.0, ((x1 - x0) / aspect - (y1 - y0)) / 2)
    axes.set_xlim(x0 - pad_x, x1 + pad_x)
    axes.set_ylim(y0 - pad_y, y1 + pad_y)


def _spread(c: Comparison) -> str:
    n = c.value("elevation_declared_cells")
    if n == 0:
        return "no terrain in common"
    middle, spread = c.value("elevation_declared_median"), c.value("elevation_declared_nmad")
    return f"median {middle:+.3g} {c.unit}, NMAD {spread:.3g} {c.unit}, {n:.0f} cells"


def _legend(figure: Figure, c: Comparison, limit: float, height: float) -> None:
    """Class swatches for both maps on the left, the colours of the difference on the right."""
    shown = (*TASK_CLASSES, TaskClass.UNKNOWN)
    handles = [
        Patch(color=_colour(k), label=k.name.replace("_", " ").lower()) for k in shown
    ] + [Patch(facecolor=(_GREY,) * 3, label="no common terrain")]  # fmt: skip
    figure.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(_GAP / _WIDTH, 0.34 / height),
        bbox_transform=figure.transFigure, ncols=len(handles), frameon=False, fontsize=8, handlelength=1.1,
        handleheight=1.1, columnspacing=1.0, borderaxespad=0, borderpad=0.1, labelcolor=_INK,
    )  # fmt: skip
    agreement, shared = c.value("label_agreement"), c.value("coverage_observed_shared")
    facts = [f"classes agree on {agreement:.1f} % of what both classify", f"{shared:.0f} % of what one sees, both see"]
    place = c.a.map.georeference
    how = "cameras of equal names" if c.placement.way == "cameras" else "georeferences"
    facts += [f"B placed by {how}", f"EPSG:{place.epsg}" if place else "local frame"]
    figure.text(_GAP / _WIDTH, 0.12 / height, "  ·  ".join(facts), fontsize=8.5, color="#555555")
    wide = 2.9
    bar = figure.add_axes(((_WIDTH - _GAP - wide - 0.1) / _WIDTH, 0.44 / height, wide / _WIDTH, 0.12 / height))
    colours = ScalarMappable(Normalize(-limit, limit), cmcrameri.cm.vik)
    colourbar = figure.colorbar(colours, cax=bar, orientation="horizontal", extend="both", extendfrac=0.03)
    colourbar.outline.set_visible(False)
    colourbar.set_ticks([-limit, -limit / 2, 0, limit / 2, limit])
    colourbar.ax.set_xticklabels([f"{t:+g}" if t else "0" for t in (-limit, -limit / 2, 0, limit / 2, limit)])
    colourbar.ax.tick_params(labelsize=8, length=2, color=_INK, labelcolor=_INK, pad=1.5)
    bar.text(
        -0.04, 0.5, f"B lower | B higher [{c.unit}]", fontsize=8.5, ha="right", va="center",
        transform=bar.transAxes, color=_INK,
    )  # fmt: skip
