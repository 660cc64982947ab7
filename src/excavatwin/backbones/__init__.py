"""Frozen models that turn photos into observations: one room per model, imported only when it is used."""
