"""Run what is sensitive to rounding as other processors would round: ``make portable``.

Two sets of switches take instructions away from the libraries: all beyond SSE4.2, and AVX-512. Each
set first has to prove that it acts: a product of matrices, exponentials, a blur and the C library's
functions, hashed to the last bit, come out otherwise. Then the sensitive tests run under it, and
the notebooks with their checks, both with fresh caches. ``--quick`` runs what takes few minutes.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

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
QUICK = ["tests/test_disturbed.py", "tests/compendium/test_synthetic_data.py"]
ALL = [
    *QUICK,
    *(f"tests/{room}" for room in ("calibration", "tracking", "servoing", "focus", "synthetic")),
]


def probe(switches: dict[str, str]) -> dict[str, str]:
    """Return the hash of each library's numbers."""
    command = [sys.executable, "-c", PROBE]
    said = subprocess.run(command, env=os.environ | switches, capture_output=True, check=True)
    pairs = (line.split(" ", 1) for line in said.stdout.decode().splitlines())
    return {name: digest for digest, name in pairs}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="what takes at most four minutes")
    quick = parser.parse_args().quick
    plain, failed = probe({}), []
    for name, switches in SWITCHES.items():
        print(f"As a processor with {name}:")
        hashes = probe(switches)
        for library, digest in hashes.items():
            acts = "acts" if digest != plain[library] else "does not act on this processor"
            print(f"  {library}: {plain[library]} → {digest}, {acts}")
        if hashes == plain:
            print(f"  none of the switches to {name} acts here: nothing to be seen")
            continue
        with tempfile.TemporaryDirectory() as folder:
            # A copy, so that nothing that was built or kept before is taken for its own.
            copy = Path(folder) / "copy"
            ignored = shutil.ignore_patterns(".git", ".venv*", "build", "__pycache__", ".*_cache")
            shutil.copytree(ROOT, copy, ignore=ignored)
            where = os.environ | switches | {"PYTHONPATH": str(copy), "OPENBLAS_NUM_THREADS": "1"}
            tests = ["-m", "pytest", "-q", "-n", "2", "-p", "no:cacheprovider"]
            commands = {"tests": [*tests, *(QUICK if quick else ALL)]}
            # The slowest chapter takes longer than all the rest.
            commands["notebooks"] = ["-m", "compendium.run", *(["04", "07"] if quick else [])]
            for what, command in commands.items():
                run = subprocess.run([sys.executable, *command], cwd=copy, env=where, check=False)
                failed += [f"{what} as with {name}"] * bool(run.returncode)
    print(f"Failed: {', '.join(failed)}" if failed else "The conclusions are the same.")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
