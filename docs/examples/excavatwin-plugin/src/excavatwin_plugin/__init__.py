"""Backbones for ExcavaTwin."""
