"""Scenes with known truth: what the algorithms are tested on. Nothing here imports an algorithm."""
