"""Frames of a camera recorded without change, and played back: MCAP files (extra `mcap`)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={"record": ["attached_background", "attached_calibration", "attachments_of"]},
)
