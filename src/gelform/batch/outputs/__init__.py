"""What a batch writes: the maps of a result, and one file for each form they are written in."""

from gelform.batch.outputs.maps import facts_of, maps_of
from gelform.batch.outputs.writers import WRITERS, OutputFile, PartWriter, Place, finish_of

__all__ = ["WRITERS", "OutputFile", "PartWriter", "Place", "facts_of", "finish_of", "maps_of"]
