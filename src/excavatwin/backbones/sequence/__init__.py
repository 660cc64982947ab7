"""Long sequences on small memory: choose views, reconstruct overlapping chunks, align them, close loops."""
