"""The result of one frame, the table of its maps, and its files; the command line's help reads only the table."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
