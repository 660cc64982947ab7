"""Finished reconstructions of other programs: their files -> observations (readers: backbones/reconstructors)."""
