"""A SITE folder: one file per format, each of which opens in somebody's program."""

from __future__ import annotations

from excavatwin.export.layer_table import LayerRow, describe_layers
from excavatwin.export.site_folder import write_site

__all__ = ["LayerRow", "describe_layers", "write_site"]
