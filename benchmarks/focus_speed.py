"""The default depth's time, memory and first call, beside box filters over the same frames.

Run as ``python -m benchmarks.focus_speed``; takes two minutes. CPU time, both measured in turn: on
a machine that has other work, too, their ratio changes by a tenth.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from time import perf_counter, process_time

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.report import must_hold, publish
from microlib import synthetic
from microlib.focus import depth_from_focus

#: Frames and their side, px.
COUNT, SIDE = 21, 1024
POSITIONS = np.arange(float(COUNT))
ROUNDS = 5

TIME = "CPU time of one thread, 21 frames of 1024×1024, passes of cv2.boxFilter 5×5"
FIRST = "CPU time of the import and of a first call, s"
MEMORY = "Peak memory beyond the frames, bytes a pixel"


def scenes() -> dict[str, NDArray]:
    """Return a slope, a step, and a step with bare ground that has no depth."""
    shape = (SIDE, SIDE)
    y, x = np.indices(shape)
    slope = 10 + synthetic.tilted_plane(shape, 12 / SIDE, 0.0)
    step = 5.7 + synthetic.step(shape, 7.7)
    bare = np.sin(x / 60) * np.sin(y / 50) > 0.55
    found = {}
    for name, depth, hole in (
        ("slope", slope, False),
        ("step", step, False),
        ("step, holes", step, True),
    ):
        rng = np.random.default_rng(0)
        texture = synthetic.mixed_texture(shape, rng)
        texture = np.where(hole & bare, texture.mean(), texture)
        found[name] = synthetic.focal_stack(
            texture, depth, POSITIONS, blur_rate=1.0, noise=2.0, rng=rng
        )
    return found


def boxes(stack: NDArray, buffer: NDArray) -> None:
    for frame in stack:
        cv2.boxFilter(frame, cv2.CV_32F, (5, 5), dst=buffer)


def passes(stack: NDArray, call: Callable[[], object]) -> tuple[float, float]:
    """Return least and median ratio of a call to as long a time of box filters around it."""
    buffer = np.empty(stack.shape[1:], np.float32)
    call()
    ratios = []
    for _ in range(ROUNDS):
        times = []
        for work, times_done in ((None, 25), (call, 1), (None, 25)):
            start = process_time()
            for _ in range(times_done):
                work() if work else boxes(stack, buffer)
            times.append((process_time() - start) / times_done)
        ratios.append(2 * times[1] / (times[0] + times[2]))
    return min(ratios), float(np.median(ratios))


def gain_of_two(stack: NDArray) -> tuple[float, float]:
    """Return how much sooner two threads are done with the depth, and with the box filters."""
    buffers = np.empty((2, *stack.shape[1:]), np.float32)
    gains = []
    with ThreadPoolExecutor(2) as pool:
        for _ in range(ROUNDS):
            times = []
            for workers in (1, 2):
                start = perf_counter()
                depth_from_focus(stack, POSITIONS, workers=workers)
                times.append(perf_counter() - start)
            start = perf_counter()
            for _ in range(20):
                boxes(stack, buffers[0])
            times.append(perf_counter() - start)
            start = perf_counter()
            halves = [stack[k::2] for k in range(2)]
            for _ in range(20):
                list(pool.map(boxes, halves, buffers))
            times.append(perf_counter() - start)
            gains.append((times[0] / times[1], times[2] / times[3]))
    depth, box = np.median(gains, axis=0)
    return float(depth), float(box)


def in_new_process(code: str, *, cold: bool) -> float:
    """Return the number that a script prints, with compiled loops kept from before or not."""
    with tempfile.TemporaryDirectory() as folder:
        changed = {"NUMBA_CACHE_DIR": folder} if cold else {}
        command = [sys.executable, "-c", code]
        found = subprocess.run(
            command, check=True, capture_output=True, text=True, env={**os.environ, **changed}
        )
    return float(found.stdout)


IMPORT = """
from time import process_time
start = process_time()
import microlib.focus
print(process_time() - start)
"""
CALL = """
from time import process_time
import numpy as np
from microlib.focus import depth_from_focus
stack = np.random.default_rng(0).integers(0, 256, (9, 64, 64)).astype(np.uint8)
start = process_time()
depth_from_focus(stack, np.arange(9.0))
print(process_time() - start)
"""
#: The same small stack first: loading the compiled loops takes memory of its own.
WEIGH = f"""
from pathlib import Path
import numpy as np
from microlib.focus import depth_from_focus

def peak():
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(line for line in lines if line.startswith("VmHWM")).split()[1])

rng = np.random.default_rng(0)
stack = rng.integers(0, 256, ({COUNT}, {SIDE}, {SIDE}), dtype=np.uint8)
z = np.arange({COUNT}.0)
depth_from_focus(stack[:, :64, :64], z)
before = peak()
depth_from_focus(stack, z)
print((peak() - before) / {SIDE}**2)
"""


NOTE = """\
Time is processor time of one thread, in units of one pass of OpenCV's 5×5 box filter over the same
frames. Both are measured in turn. On a machine that does other work as well, their ratio changes
by a tenth. The first call compiles the code, which later processes load from disk.
"""


def main() -> None:
    cv2.setNumThreads(1)
    stacks = scenes()
    calls = {
        name: (stack, lambda stack=stack: depth_from_focus(stack, POSITIONS))
        for name, stack in stacks.items()
    }
    slope = stacks["slope"]
    calls["slope, SML"] = slope, lambda: depth_from_focus(slope, POSITIONS, measure="sml")
    times = {name: passes(*call) for name, call in calls.items()}
    depth, box = gain_of_two(slope)
    first = {
        "import microlib.focus": in_new_process(IMPORT, cold=False),
        "first call, compiling": in_new_process(CALL, cold=True),
        "first call, loading": in_new_process(CALL, cold=False),
    }
    memory = in_new_process(WEIGH, cold=False)
    rows = [(name, round(low, 1), round(middle, 1)) for name, (low, middle) in times.items()]
    tables = {
        TIME: pd.DataFrame(rows, columns=["scene", "least", "median"]),
        FIRST: pd.DataFrame([(k, round(v, 2)) for k, v in first.items()], columns=["what", "s"]),
        MEMORY: pd.DataFrame([("default", round(memory))], columns=["what", "bytes"]),
    }
    limits = must_hold(
        [
            ("default depth of a slope, passes", times["slope"][0], "≤", 70),
            ("default depth of a step, passes", times["step"][0], "≤", 90),
            ("default depth of a step with holes, passes", times["step, holes"][0], "≤", 90),
            ("SML and three points, passes", times["slope, SML"][0], "≤", 3.5),
            (
                f"gain of two threads; the box filter's is {box:.2f}",
                depth,
                "≥",
                min(1.5, 0.85 * box),
            ),
            ("import, s", first["import microlib.focus"], "≤", 0.3),
            ("first call that compiles, s", first["first call, compiling"], "≤", 15),
            ("memory, bytes a pixel", memory, "≤", 40),
        ]
    )
    publish("focus_speed", tables, limits=limits, note=NOTE)


if __name__ == "__main__":
    main()
