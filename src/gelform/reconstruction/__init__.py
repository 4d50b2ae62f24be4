"""What one frame gave; saved, loaded and shown."""

from gelform.reconstruction.file import KIND, load_result, save_result
from gelform.reconstruction.record import Reconstruction

__all__ = ["KIND", "Reconstruction", "load_result", "save_result"]
