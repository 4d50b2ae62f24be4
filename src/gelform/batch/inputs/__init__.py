"""The input of a batch: sequences of frames are listed, split into parts and read."""
