"""All backbones by name: those that ship with ExcavaTwin, and those that other packages bring by entry points."""

from __future__ import annotations

import difflib
import importlib
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

from excavatwin.backbones.cards import Card
from excavatwin.errors import ExcavatwinError, InputError

Kind = Literal["reconstructor", "segmenter"]

#: Name -> home of the ones that ship, in the order in which they are listed.
SHIPPED: dict[Kind, dict[str, str]] = {
    "reconstructor": {
        "photogrammetry": "excavatwin.backbones.photogrammetry:Photogrammetry",
        "vggt": "excavatwin.backbones.reconstructors.vggt:Vggt",
        "depth-anything-3": "excavatwin.backbones.reconstructors.depth_anything_3:DepthAnything3",
        "map-anything": "excavatwin.backbones.reconstructors.map_anything:MapAnything",
        "pi3": "excavatwin.backbones.reconstructors.pi3:Pi3",
        "mast3r": "excavatwin.backbones.reconstructors.mast3r:Mast3r",
        "dust3r": "excavatwin.backbones.reconstructors.dust3r:Dust3r",
        "colmap": "excavatwin.backbones.reconstructors.colmap:Colmap",
        "opendronemap": "excavatwin.backbones.reconstructors.opendronemap:OpenDroneMap",
        "nerfstudio": "excavatwin.backbones.reconstructors.nerfstudio:Nerfstudio",
        "rgbd": "excavatwin.backbones.reconstructors.rgbd:Rgbd",
        "cloud": "excavatwin.backbones.reconstructors.cloud:Cloud",
    },
    "segmenter": {
        "appearance": "excavatwin.backbones.appearance:Appearance",
        "yoloe": "excavatwin.backbones.segmenters.yoloe:Yoloe",
        "mask2former": "excavatwin.backbones.segmenters.mask2former:Mask2Former",
        "oneformer": "excavatwin.backbones.segmenters.oneformer:OneFormer",
        "eomt": "excavatwin.backbones.segmenters.eomt:Eomt",
        "segformer": "excavatwin.backbones.segmenters.segformer:Segformer",
        "sam3": "excavatwin.backbones.segmenters.sam3:Sam3",
        "grounded-sam": "excavatwin.backbones.segmenters.grounded_sam:GroundedSam",
        "clipseg": "excavatwin.backbones.segmenters.clipseg:ClipSeg",
        "onnx": "excavatwin.backbones.segmenters.onnx:Onnx",
        "masks": "excavatwin.backbones.segmenters.masks:Masks",
    },
}


@dataclass(frozen=True)
class Entry:
    """One backbone that can be chosen."""

    name: str
    kind: Kind
    home: str
    """``module:Class``."""
    package: str
    """Who brings it: ``excavatwin``, or the distribution of a plugin."""

    def load(self) -> type[Any]:
        """Its class. Importing the module of a shipped one imports no model library.

        Raises:
            InputError: the plugin is broken.
        """
        module, _, name = self.home.partition(":")
        try:
            return getattr(importlib.import_module(module), name)
        except ExcavatwinError:
            raise
        except Exception as error:
            raise InputError(
                f"{self.kind} {self.name} of package {self.package} cannot be imported from {self.home} "
                f"({type(error).__name__}: {error}); mend or uninstall that package."
            ) from error

    def card(self) -> Card:
        """Its card."""
        card = getattr(self.load(), "card", None)
        if not isinstance(card, Card):
            raise InputError(f"{self.kind} {self.name} of package {self.package} has no card; see docs/backbones.md.")
        return card


def entries(kind: Kind) -> tuple[Entry, ...]:
    """All backbones of a kind, the shipped ones first; a plugin cannot take the name of a shipped one."""
    found = [Entry(name, kind, home, "excavatwin") for name, home in SHIPPED[kind].items()]
    taken = set(SHIPPED[kind])
    for point in sorted(entry_points(group=f"excavatwin.{kind}s"), key=lambda point: point.name):
        if point.name not in taken:
            taken.add(point.name)
            found.append(Entry(point.name, kind, point.value, _owner(point)))
    return tuple(found)


def entry(kind: Kind, name: str) -> Entry:
    """The backbone of that name.

    Raises:
        InputError: there is none; the message names the nearest, or all.
    """
    known = {one.name: one for one in entries(kind)}
    if name in known:
        return known[name]
    near = difflib.get_close_matches(name, known, 1, 0.5)
    hint = f"did you mean {near[0]}?" if near else f"there are: {', '.join(known)}."
    raise InputError(f"there is no {kind} {name!r}; {hint}")


def make(kind: Kind, text: str) -> Any:
    """A backbone with default parameters from ``name`` or ``name:value`` (weights, folder or file).

    Raises:
        InputError: no such backbone, or it takes no value.
    """
    name, _, value = text.partition(":")
    found = entry(kind, name.strip())
    backbone = found.load()
    if not value:
        return backbone()
    argument = found.card().argument
    if not argument:
        raise InputError(f"{kind} {name} takes nothing after the colon, but {value!r} was given.")
    return backbone(**{argument: value})


def _owner(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else "unknown"
