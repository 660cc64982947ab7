"""The cached way from photos, or from observations, to a SITE folder."""

from excavatwin.survey.pipeline import fuse_observations, map_photos

__all__ = ["fuse_observations", "map_photos"]
