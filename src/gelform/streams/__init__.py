"""Frames of one sensor in sequence: what has memory, around a Reconstructor that has none."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "memory": ["Memory", "StreamFrame"],
        "pipeline": ["Pipeline", "StreamStats"],
        "stream": ["Stream", "stream"],
    },
)
