"""What one frame gave, the table of its maps, and its files; the command line's help reads the table alone."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
