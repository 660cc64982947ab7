"""Nouns: what the method talks about. They import no algorithm, no file format and no model library."""
