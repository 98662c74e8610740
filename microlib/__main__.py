"""Run ``python -m microlib``, the same as the command ``microlib``."""

from microlib._command import main

if __name__ == "__main__":
    raise SystemExit(main())
