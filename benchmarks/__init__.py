"""Peers and limits side by side; run one with ``python -m benchmarks.NAME``. Never part of the tests."""
