"""Measure what is named, as ``python -m benchmarks focus tracking``; without a name, everything."""

from __future__ import annotations

import sys
from importlib import import_module

import cv2

from benchmarks.report import RESULTS, publish

if __name__ == "__main__":
    cv2.setNumThreads(1)
    for name in sys.argv[1:] or sorted(path.stem for path in RESULTS.glob("*.json")):
        module = import_module(f"benchmarks.{name}")
        publish(name, *module.main(), module.NOTE)
