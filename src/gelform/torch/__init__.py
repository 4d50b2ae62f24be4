"""Depth from a batch of images in PyTorch, on any device and differentiable; needs the extra `torch`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__, submod_attrs={"reconstruct": ["BatchReconstruction", "Reconstruct"]}
)
