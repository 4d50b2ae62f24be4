"""What a batch works on: sequences of frames, listed, parted and read."""

from gelform.batch.inputs.listing import Listing, listing_of
from gelform.batch.inputs.plan import Part, plan_of, shard_of
from gelform.batch.inputs.reading import NamedFrame, frames_of_part
from gelform.batch.inputs.sequences import Sequence

__all__ = [
    "Listing",
    "NamedFrame",
    "Part",
    "Sequence",
    "frames_of_part",
    "listing_of",
    "plan_of",
    "shard_of",
]
