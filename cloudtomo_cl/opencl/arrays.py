"""Arrays on a device, as types; `Device` makes them."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np


class DeviceArray(Protocol):
    """The part of pyopencl's array interface that this package uses."""

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
        """A copy on the host that is still being filled, and the event that says when it is complete."""
        ...

    def set(self, values: np.ndarray, /) -> None:
        """Copies an array of the host into this array."""
        ...

    def fill(self, value: float, /) -> Any:
        """Sets all elements to one value."""
        ...

    def copy(self) -> DeviceArray:
        """A second array on the device with the same values."""
        ...

    def astype(self, dtype: Any, /) -> DeviceArray:
        """A copy with another dtype."""
        ...

    def view(self, dtype: Any, /) -> DeviceArray:
        """The same memory, read as another dtype."""
        ...

    def __mul__(self, factor: Any, /) -> DeviceArray: ...

    def __imul__(self, factor: Any, /) -> DeviceArray: ...
