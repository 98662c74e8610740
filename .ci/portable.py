"""Run the notebooks and every test as other processors would round: ``make portable``.

Two sets of switches take instructions away from the libraries: all beyond SSE4.2, and AVX-512. Each
set first has to prove that it acts: a product of matrices, exponentials, a blur and the C library's
functions, hashed to the last bit, come out otherwise. Then everything runs under it, in a copy
without caches. ``--quick`` runs a part of the tests of every package under the first set, another
part for each commit.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
NUMPY_V4 = "X86_V4 AVX512_ICL AVX512_SPR"
SWITCHES = {
    "SSE4.2": {
        "OPENBLAS_CORETYPE": "Nehalem",
        "NPY_DISABLE_CPU_FEATURES": f"X86_V3 {NUMPY_V4}",
        "OPENCV_CPU_DISABLE": "AVX,FP16,AVX2,AVX512-SKX",
        "OPENCV_IPP": "sse42",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F",
    },
    "AVX2": {
        "OPENBLAS_CORETYPE": "Haswell",
        "NPY_DISABLE_CPU_FEATURES": NUMPY_V4,
        "OPENCV_CPU_DISABLE": "AVX512-SKX",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F",
    },
}
PROBE = """
import hashlib, math, cv2, numpy as np
a = np.random.default_rng(0).random((64, 64))
b = a.astype(np.float32)
found = {
    "OpenBLAS (OPENBLAS_CORETYPE), a product": (a @ a, b @ b),
    "NumPy (NPY_DISABLE_CPU_FEATURES), exponentials": (np.exp(a), np.exp(b), a**3.3),
    "OpenCV (OPENCV_CPU_DISABLE), a blur": (cv2.GaussianBlur(a, (0, 0), 1.7),),
    "C library (GLIBC_TUNABLES), sines": (np.array([math.sin(9 * x) ** 1.3 for x in a[a > 0.5]
                                                    if math.sin(9 * x) > 0]),),
}
for name, arrays in found.items():
    print(hashlib.sha256(b"".join(x.tobytes() for x in arrays)).hexdigest()[:8], name)
"""
#: One test in so many is a part of a package, and at least so many are.
ONE_IN, LEAST = 16, 3


def pytest_collection_modifyitems(config: Any, items: list[Any]) -> None:
    """Keep a part of each package's tests; ``--quick`` names this file to pytest as a plugin."""
    packages: dict[str, list[Any]] = {}
    for item in items:
        # What looks at the built book is not sensitive, and the copy has no book.
        if not {"html", "claims_folder"} & set(item.fixturenames):
            packages.setdefault(item.nodeid.removeprefix("tests/").split("/")[0], []).append(item)
    kept = []
    for package, tests in packages.items():
        count = min(len(tests), max(LEAST, len(tests) // ONE_IN))
        kept += random.Random(f"{os.environ['PART']} {package}").sample(tests, count)
    config.hook.pytest_deselected(items=[item for item in items if item not in kept])
    items[:] = [item for item in items if item in kept]


def probe(switches: dict[str, str]) -> dict[str, str]:
    """Return the hash of each library's numbers."""
    command = [sys.executable, "-c", PROBE]
    said = subprocess.run(command, env=os.environ | switches, capture_output=True, check=True)
    pairs = (line.split(" ", 1) for line in said.stdout.decode().splitlines())
    return {name: digest for digest, name in pairs}


def part() -> str:
    """Return what the part depends on: the commit, or where there is none the tests themselves."""
    command = ["git", "rev-parse", "HEAD"]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if said.returncode == 0:
        return said.stdout.strip()
    tests = b"".join(file.read_bytes() for file in sorted(ROOT.glob("tests/**/*.py")))
    return hashlib.sha256(tests).hexdigest()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="what takes at most four minutes")
    quick = parser.parse_args().quick
    tests = ["-m", "pytest", "-q", "-n", "2", "-p", "no:cacheprovider"]
    commands = {
        "notebooks": ["-m", "compendium.run"],
        "book": ["-m", "compendium.book"],
        "tests": tests,
    }
    if quick:
        print(f"The part of the tests is that of {part()}.")
        commands = {
            "tests": [*tests, "-p", Path(__file__).stem, "-m", "not book and not notebooks"]
        }
    plain, failed = probe({}), []
    for name, switches in list(SWITCHES.items())[: 1 if quick else None]:
        print(f"As a processor with {name}:")
        hashes = probe(switches)
        for library, digest in hashes.items():
            acts = "acts" if digest != plain[library] else "does not act on this processor"
            print(f"  {library}: {plain[library]} → {digest}, {acts}", flush=True)
        if hashes == plain:
            print(f"  none of the switches to {name} acts here: nothing to be seen")
            continue
        with tempfile.TemporaryDirectory() as folder:
            # A copy, so that nothing that was built or kept before is taken for its own.
            copy = Path(folder) / "copy"
            ignored = shutil.ignore_patterns(".git", ".venv*", "build", "__pycache__", ".*_cache")
            shutil.copytree(ROOT, copy, ignore=ignored)
            paths = os.pathsep.join([str(copy), str(copy / ".ci")])
            where = os.environ | switches | {"PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"}
            for what, command in commands.items():
                run = [sys.executable, *command]
                code = subprocess.run(run, cwd=copy, env=where | {"PART": part()}, check=False)
                failed += [f"{what} as with {name}"] * bool(code.returncode)
    print(f"Failed: {', '.join(failed)}" if failed else "The conclusions are the same.")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
