"""numba's `njit(cache=True)` with the type of the function kept."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile on the first call; the machine code is cached beside the module."""
    result: Function = njit(cache=True)(function)
    return result
