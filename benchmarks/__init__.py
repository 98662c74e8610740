"""Peers and limits side by side: ``python -m benchmarks.NAME``. Never part of the tests."""
