"""Peers and limits side by side: ``python -m benchmarks NAME``. Never part of the tests.

Each module has a ``NOTE`` and a ``main``, which returns tables and the limits that must hold.
"""
