"""A procedural dig site, photographed: photos with exact truth, for the sample, the tests and the benchmarks.

``DigSite`` says what the site is, ``random_site`` draws one, ``digging_series`` digs in it, ``change_truth`` says how
much. ``orbit``, ``lawnmower`` and ``hover`` fly over it, ``render_view`` takes one photo with its truth (``Fast`` and
``Photoreal`` do so under given ``Conditions``), ``site_truth`` is what a perfect survey would find,
``exact_observations`` is what perfect models would deliver.
"""

from __future__ import annotations

from excavatwin.simulation.camera import Camera, look_at, orbit
from excavatwin.simulation.change import Change, change_truth
from excavatwin.simulation.conditions import Conditions
from excavatwin.simulation.digging import Digging, digging_series
from excavatwin.simulation.flights import hover, lawnmower
from excavatwin.simulation.layout import random_site
from excavatwin.simulation.observations import exact_observations
from excavatwin.simulation.render import RenderedView, render_view
from excavatwin.simulation.renderers import Fast, Photoreal
from excavatwin.simulation.site import CATEGORIES, DigSite, Placement, contents
from excavatwin.simulation.terrain import Earthworks
from excavatwin.simulation.truth import save_truth, site_truth

__all__ = [
    "CATEGORIES",
    "Camera",
    "Change",
    "Conditions",
    "DigSite",
    "Digging",
    "Earthworks",
    "Fast",
    "Photoreal",
    "Placement",
    "RenderedView",
    "change_truth",
    "contents",
    "digging_series",
    "exact_observations",
    "hover",
    "lawnmower",
    "look_at",
    "orbit",
    "random_site",
    "render_view",
    "save_truth",
    "site_truth",
]
