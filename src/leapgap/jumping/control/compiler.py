"""Numerical functions compiled by numba where it is installed (extra ``compiled``); plain Python runs them without it.

A compiled function calls compiled functions of its own file only: what numba keeps on disk is compiled again when that
file changes, and does not look at others.
"""

from collections.abc import Callable
from typing import Any

from leapgap.errors import InputError

try:
    from numba import njit
except ImportError:  # it is an extra
    njit = None

AVAILABLE = njit is not None


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, compiled at its first call for the types it is called with, and kept on disk."""
    return function if njit is None else njit(cache=True, error_model="numpy")(function)


def require_compiler(where: str) -> None:
    """Raise an ``InputError`` where functions would run uncompiled, a hundred times slower."""
    if not AVAILABLE:
        raise InputError(where, "no numba", "the extra `compiled`", "pip install 'leapgap[compiled]', or turn it off")
