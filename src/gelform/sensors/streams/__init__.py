"""Frames of one sensor in sequence: memory around a Reconstructor, which has none."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "memory": ["Memory", "StreamFrame"],
        "pipeline": ["Pipeline", "StreamStats"],
        "stream": ["Stream", "stream"],
    },
)
