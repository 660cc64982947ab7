"""Datasets: one file per data set, from its official layout to our nouns; ground truth as optional fields."""
