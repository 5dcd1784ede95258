"""3-D cloud extinction from images taken from several directions.

Lengths are in km, extinction in km^-1, angles in degrees, radiance in W m^-2 sr^-1; x runs
east, y north, z up, and the ground is z = 0.

The public names are in __init__.pyi. What they come from is imported when they are first used. Importing the package
imports nothing else, and so takes about a millisecond: before the program listens, Ctrl-C hardly finds a moment.
"""

from __future__ import annotations

TYPE_CHECKING = False  # typing's, without importing it
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

# Public names of 0.1 that are no more, and what took their place.
_RENAMED = {"Optimizer": "GaussNewton, Adam or SGD, whose arguments were those of Optimizer"}
_stub: tuple[Callable[[str], Any], Callable[[], list[str]], list[str]] | None = None


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        raise AttributeError(f"cloudtomo_cl.{name} is now {_RENAMED[name]}")
    lazy, _, names = _lazy()
    return names if name == "__all__" else lazy(name)


def __dir__() -> list[str]:
    return _lazy()[1]()


def _lazy() -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """What finds the public names, what lists them, and their list."""
    global _stub
    if _stub is None:
        import lazy_loader

        _stub = lazy_loader.attach_stub(__name__, __file__)
    return _stub
