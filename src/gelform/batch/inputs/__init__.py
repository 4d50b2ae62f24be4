"""What a batch works on: sequences of frames, listed, parted and read."""
