"""The default depth in tiles: the same bits as in one piece, its memory, and what a kill costs.

Run as ``python -m benchmarks.focus_tiles``; takes five minutes, and needs zarr, dask and
distributed (``pip install microlib[dask]``). With ``--whole`` it also does all of a stack of
16384×16384×20, in ten to twenty minutes.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.report import must_hold, publish
from microlib import synthetic
from microlib.focus import FocusResult, depth_from_focus, depth_to_zarr

zarr: Any = import_module("zarr") if find_spec("zarr") else None
distributed: Any = import_module("distributed") if find_spec("distributed") else None

#: A strip is seen by no tile as a whole: a tile looks at half a thousand pixels to either side.
STRIP, FRAMES, SEEDS = (90, 1900), 15, range(3)
SIDES = (128, 256, 1024)
#: Side of the large stack for memory, frames, and the side of its tiles, px.
LARGE, COUNT, TILE = 4096, 20, 1024
#: The stack that is shared and killed, and its tiles.
SHARED, SHARED_TILE, KILLED_AT = (640, 1536), 256, 7
MAPS = ("depth", "uncertainty", "confidence", "index", "all_in_focus", "at_end")

BITS = "Pixels whose bits differ from the depth in one piece, over strips of three seeds"
MEMORY = "A stack of 20 frames of 4096×4096, 8 bits, from a zarr into a zarr"
KILLS = "18 tiles on two workers, one killed; and a run that is killed and begun again"


def scenes(shape: tuple[int, int]) -> dict[str, Callable[[int], NDArray]]:
    """Return stacks by name and seed: slopes, steps, holes, and strokes that have halos."""
    y, x = np.indices(shape)

    def stack(height: NDArray, kind: str, seed: int) -> NDArray:
        rng = np.random.default_rng(seed)
        texture = synthetic.mixed_texture(shape, rng)
        if kind == "holes":
            bare = (np.sin(x / 60 + seed) * np.sin(y / 50 + 1) > 0.3) | (np.sin(x / 333) > 0.8)
            texture = np.where(bare, texture.mean(), texture)
        if kind == "strokes":
            texture = np.where(x % (36 + seed) < 6, 230.0, 40.0) + (x > shape[1] / 2) * texture / 9
        positions = np.arange(float(FRAMES))
        return np.asarray(
            synthetic.focal_stack(texture, height, positions, blur_rate=1.0, noise=2.0, rng=rng)
        )

    slope = 2 + synthetic.tilted_plane(shape, 10 / shape[1], 0.01)
    steps = 3.2 + 8.0 * ((x // 97) % 2)
    waves = 7 + 5 * np.sin(x / 190) * np.cos(y / 70)
    kinds = {
        "slope": (slope, ""),
        "steps": (steps, ""),
        "steps, holes": (steps, "holes"),
        "waves, holes": (waves, "holes"),
        "slope, strokes": (slope, "strokes"),
    }
    return {
        name: lambda seed, height=height, kind=kind: stack(height, kind, seed)
        for name, (height, kind) in kinds.items()
    }


def different(one: FocusResult, other: FocusResult) -> int:
    """Return how many pixels differ in some map; unknown is as unknown."""
    wrong = np.zeros(one.depth.shape, bool)
    for name in MAPS:
        a, b = getattr(one, name), getattr(other, name)
        wrong |= (a != b) & ~((a != a) & (b != b))
    return int(wrong.sum())


def bits() -> pd.DataFrame:
    rows = []
    positions = np.arange(float(FRAMES))
    for name, make in scenes(STRIP).items():
        counts: Counter[str] = Counter()
        unknown = 0.0
        for seed in SEEDS:
            stack = make(seed)
            if seed % 2:
                stack = np.ascontiguousarray(stack.transpose(0, 2, 1))
            whole = depth_from_focus(stack, positions)
            unknown += float(np.isnan(whole.depth).mean()) / len(SEEDS)
            for side in SIDES:
                found = depth_from_focus(stack, positions, tile=side, workers=1 + seed % 2)
                counts[f"{side} px"] += different(found, whole)
        rows.append((name, round(unknown, 2), *(counts[f"{side} px"] for side in SIDES)))
    return pd.DataFrame(rows, columns=["scene", "unknown", *(f"tiles {s} px" for s in SIDES)])


def large_stack(path: Path, side: int) -> None:
    """Write a stack that repeats one of 1024×1024."""
    shape = (1024, 1024)
    y, x = np.indices(shape) * 2 * np.pi / 1024
    rng = np.random.default_rng(0)
    texture = synthetic.mixed_texture(shape, rng)
    positions = np.arange(float(COUNT))
    height = 10 + 7 * np.sin(x) * np.cos(y)
    small = synthetic.focal_stack(texture, height, positions, blur_rate=1.0, noise=2.0, rng=rng)
    stack = zarr.create_array(path, shape=(COUNT, side, side), chunks=(1, 512, 512), dtype="u1")
    for k, frame in enumerate(small):
        for top in range(0, side, 1024):
            stack[k, top : top + 1024] = np.tile(frame, (1, side // 1024))


#: Its peak is that of the whole process, libraries and all.
DO = """
import sys
from pathlib import Path
from time import process_time
import numpy as np, zarr
from microlib.focus import depth_to_zarr

def peak():
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1024

source, target, tile = sys.argv[1:]
begun, start = peak(), process_time()
depth_to_zarr(
    zarr.open_array(source, mode="r"), target, np.arange(20.0), pixel_size=1.0, tile=int(tile)
)
print(begun, peak(), process_time() - start)
"""


def memory(folder: Path, side: int) -> tuple[float, float, float]:
    """Return the peak before and after, MB, and the CPU time, µs a pixel, of a new process."""
    source = folder / f"{side}.zarr"
    large_stack(source, side)
    command = [sys.executable, "-c", DO, str(source), str(folder / f"{side} depth.zarr"), str(TILE)]
    found = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    begun, peak, seconds = map(float, found)
    return begun, peak, seconds / side**2 * 1e6


class Logged:
    """Frames in a file, with a line in another for every tile whose frames are loaded."""

    def __init__(self, folder: Path, stack: NDArray) -> None:
        np.save(folder / "frames.npy", stack)
        self.folder, self.shape, self.dtype = folder, stack.shape, stack.dtype

    def __getitem__(self, key: int | tuple) -> NDArray:
        if isinstance(key, tuple) and key[0] == 0 and key[1].stop != 1:
            with (self.folder / "log").open("a") as log:
                log.write(f"{key[1:]}\n")
        return np.load(self.folder / "frames.npy", mmap_mode="r")[key]


def shared(folder: Path, *, kill_worker: bool) -> None:
    """Do the depth of a stack on two workers; one is killed in the middle, if asked for."""
    frames = Logged(folder, np.load(folder / "stack.npy", mmap_mode="r"))
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        pids = list(client.run(os.getpid).values())

        def progress(done: int, _: int) -> None:
            if kill_worker and done == KILLED_AT:
                os.kill(pids[0], signal.SIGKILL)

        options = {"tile": SHARED_TILE, "client": client, "progress": progress}
        positions = np.arange(float(FRAMES))
        depth_to_zarr(frames, folder / "depth.zarr", positions, pixel_size=1.0, **options)


def loads(folder: Path) -> int:
    """Return how often the frames of tiles were loaded; the survey loads whole ones."""
    return len((folder / "log").read_text().splitlines())


def done_of(folder: Path) -> int:
    """Return how many tiles are done."""
    try:
        return int(zarr.open_group(folder / "depth.zarr", mode="r")["tiles"][:].sum())
    except (KeyError, FileNotFoundError):
        return 0


def wrong_in(folder: Path, whole: FocusResult) -> int:
    root = zarr.open_group(folder / "depth.zarr", mode="r")
    found = FocusResult(**{name: root[name]["0"][:] for name in MAPS})
    return different(found, whole)


def kills(folder: Path) -> Iterator[tuple[str, int, int, int]]:
    """Yield what was killed, tiles, how often tiles were begun, and pixels that differ."""
    stack = scenes(SHARED)["waves, holes"](5)
    whole = depth_from_focus(stack, np.arange(float(FRAMES)))
    for name in ("a worker", "the run"):
        place = folder / name
        place.mkdir()
        np.save(place / "stack.npy", stack)
        command = [sys.executable, "-m", "benchmarks.focus_tiles", "--shared", str(place)]
        if name == "a worker":
            subprocess.run([*command, "--kill-worker"], check=True, stderr=subprocess.DEVNULL)
        else:
            first = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
            end = monotonic() + 300
            while done_of(place) < KILLED_AT and monotonic() < end:
                sleep(0.2)
            os.killpg(first.pid, signal.SIGKILL)
            first.wait()
            subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
        yield name, done_of(place), loads(place), wrong_in(place, whole)


NOTE = """\
`depth_to_zarr` works on stacks that are larger than memory, tile by tile. The first table compares
its depths with those of `depth_from_focus` on the whole stack, bit by bit. The second has its peak
memory, and the third what is computed twice after a worker or the whole run was killed. A stack of
16384×16384×20 takes ten to twenty minutes, and is measured only when asked for (`--whole`).
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--whole", action="store_true", help="do 16384×16384×20, too")
    parser.add_argument("--shared", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--kill-worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.shared:
        shared(options.shared, kill_worker=options.kill_worker)
        return
    if zarr is None or distributed is None:
        print("left out: pip install .[dask] to measure tiles")
        return
    same = bits()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sides = (LARGE, 16384) if options.whole else (LARGE,)
        large = [(side, *memory(folder, side)) for side in sides]
        killed = list(kills(folder))
    tables = {
        BITS: same,
        MEMORY: pd.DataFrame(
            [(s, round(b), round(p), round(t, 2)) for s, b, p, t in large],
            columns=["side, px", "libraries, MB", "peak, MB", "CPU time, µs a pixel"],
        ),
        KILLS: pd.DataFrame(
            killed, columns=["killed", "tiles done", "begun", "pixels that differ"]
        ),
    }
    limits = must_hold(
        [
            ("pixels that differ in tiles", float(same.iloc[:, 2:].to_numpy().sum()), "≤", 0),
            ("peak memory of the process, MB", max(row[2] for row in large), "≤", 600),
            ("pixels that differ after kills", float(sum(row[3] for row in killed)), "≤", 0),
            # Two workers have two tiles in flight.
            ("tiles begun twice, a worker killed", killed[0][2] - killed[0][1], "≤", 2),
            ("tiles begun twice, the run killed", killed[1][2] - killed[1][1], "≤", 2),
        ]
    )
    publish("focus_tiles", tables, limits=limits, note=NOTE)


if __name__ == "__main__":
    main()
