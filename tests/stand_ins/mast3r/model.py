"""MASt3R: as DUSt3R, in metres."""

from dust3r.model import AsymmetricCroCo3DStereo


class AsymmetricMASt3R(AsymmetricCroCo3DStereo):
    """Knows its pictures."""

    metric = True
