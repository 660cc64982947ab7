"""Stand-in of the package of that name, for tests: see ``rendered_truth``."""
