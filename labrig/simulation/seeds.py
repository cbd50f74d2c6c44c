"""Random streams that depend on their purpose, not on earlier draws."""

import hashlib

import numpy as np


def stream(seed: int, *purpose: str | int | None) -> np.random.Generator:
    """Return the generator for one purpose.

    Parameters
    ----------
    seed : int
        The protocol's seed.
    purpose : str, int or None
        Names and indexes, e.g. ("hole", specimen, hole, needle). Equal arguments give equal streams,
        other arguments unrelated streams.
    """
    text = repr((seed, *purpose))
    return np.random.default_rng(int.from_bytes(hashlib.sha256(text.encode()).digest()[:16], "big"))
