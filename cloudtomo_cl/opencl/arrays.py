"""Arrays on a device, as types; `Device` makes them."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np


class DeviceArray(Protocol):
    """What is used of pyopencl's arrays."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    @property
    def dtype(self) -> np.dtype: ...

    @property
    def size(self) -> int: ...

    @property
    def nbytes(self) -> int: ...

    @property
    def data(self) -> Any: ...

    def get(self) -> np.ndarray:
        """A copy on the host."""
        ...

    def get_async(self) -> tuple[np.ndarray, Any]:
        """A copy on the host, and the event when it is there."""
        ...

    def set(self, values: np.ndarray, /) -> None:
        """Takes the values of an array of the host."""
        ...

    def fill(self, value: float, /) -> Any:
        """Makes all values one."""
        ...

    def copy(self) -> DeviceArray:
        """Another with the same values."""
        ...

    def astype(self, dtype: Any, /) -> DeviceArray:
        """A copy of another type."""
        ...

    def view(self, dtype: Any, /) -> DeviceArray:
        """The same memory as numbers of another type."""
        ...

    def __mul__(self, factor: Any, /) -> DeviceArray: ...

    def __imul__(self, factor: Any, /) -> DeviceArray: ...
