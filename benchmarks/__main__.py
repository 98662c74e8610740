"""Measure what is named, as ``python -m benchmarks focus tracking``; without a name, everything.

Each file of results is written when its benchmark ends: what is stopped loses only itself.
"""

from __future__ import annotations

import json
import sys
import traceback
from importlib import import_module
from time import perf_counter

import cv2

from benchmarks.report import RESULTS, publish

if __name__ == "__main__":
    cv2.setNumThreads(1)
    records = {path.stem: json.loads(path.read_text()) for path in sorted(RESULTS.glob("*.json"))}
    last = {name: record.get("minutes", 0) for name, record in records.items()}
    names = sys.argv[1:] or list(last)
    times = ", ".join(f"{name} {last.get(name) or 'not known'}" for name in names)
    print(f"About {sum(last.get(name, 0) for name in names):.0f} minutes: {times}", flush=True)
    failed = []
    for name in names:
        start = perf_counter()
        try:
            module = import_module(f"benchmarks.{name}")
            tables, limits = module.main()
            publish(name, tables, limits, module.NOTE, (perf_counter() - start) / 60)
        except KeyboardInterrupt:
            sys.exit(f"Stopped in {name}; the results of those before it are kept")
        except Exception:
            traceback.print_exc()
            failed.append(name)
    sys.exit(f"Failed: {', '.join(failed)}" if failed else 0)
