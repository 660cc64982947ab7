"""Sec. "Geometry-Semantic Fusion": projection, spatial consistency, reliability, vote, admissibility, decision."""
