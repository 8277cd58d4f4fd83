"""Measurements by hand, ``python -m tests.benchmarks.<name>``; missing input is told in one message, exit code 2."""

import sys
from collections.abc import Callable
from pathlib import Path

from leapgap.errors import InputError


def run_benchmark(main: Callable[[], None]) -> None:
    """Run a benchmark's ``main``; every benchmark calls this as its ``__main__``."""
    try:
        main()
    except InputError as error:
        print(f"tests.benchmarks.{Path(sys.argv[0]).stem}: {error}", file=sys.stderr)
        raise SystemExit(2) from None
