"""Random numbers as the kernels draw them: docs/reference/random-numbers.md gives their meaning."""

from __future__ import annotations

from functools import lru_cache

import numpy as np


def philox(counter: np.ndarray, key: np.ndarray) -> np.ndarray:
    """Philox4x32-10: 128 random bits of a counter and a key.

    Parameters
    ----------
    counter : shape (..., 4), of 32 bits each
    key : shape (..., 2), of 32 bits each

    Returns uint32, shape (..., 4).

    Source: Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3", section 3.3.
    """
    word, low = np.uint64(32), np.uint64(0xFFFFFFFF)
    counter, key = np.asarray(counter, np.uint64), np.asarray(key, np.uint64)
    left_0, right_0, left_1, right_1 = (counter[..., i] for i in range(4))
    for n in range(10):
        # The key is bumped by Weyl sequences of the golden ratio and of sqrt(3) - 1.
        key_0 = (key[..., 0] + np.uint64(n * 0x9E3779B9)) & low
        key_1 = (key[..., 1] + np.uint64(n * 0xBB67AE85)) & low
        product_0 = np.uint64(0xD2511F53) * left_0
        product_1 = np.uint64(0xCD9E8D57) * left_1
        left_0, right_0 = (product_1 >> word) ^ right_0 ^ key_0, product_1 & low
        left_1, right_1 = (product_0 >> word) ^ right_1 ^ key_1, product_0 & low
    return np.stack([left_0, right_0, left_1, right_1], axis=-1).astype(np.uint32)


def open_uniform(bits: np.ndarray) -> np.ndarray:
    """32 random bits as a float32 in the open interval (0, 1); the same shape."""
    scaled = (np.asarray(bits, np.uint32).astype(np.float32) + np.float32(0.5)) * np.float32(2.0**-32)
    return np.minimum(scaled, np.float32(1 - 2.0**-24))


def uniforms(seed: int, iteration: int, view: int, pixel: int, sample: int, block: int) -> np.ndarray:
    """The four uniform numbers of one block, float64 (of float32 values), shape (4,)."""
    return _blocks(seed, iteration, view, pixel, sample, block // _TOGETHER)[block % _TOGETHER]


# An event of a path draws from a few blocks that follow each other.
_TOGETHER = 16


@lru_cache(maxsize=16)
def _blocks(seed: int, iteration: int, view: int, pixel: int, sample: int, part: int) -> np.ndarray:
    counter = np.empty((_TOGETHER, 4), np.uint64)
    counter[:, :3] = pixel, view, sample
    counter[:, 3] = part * _TOGETHER + np.arange(_TOGETHER)
    return open_uniform(philox(counter, np.array([seed, iteration]))).astype(float)
