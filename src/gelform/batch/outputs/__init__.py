"""What a batch writes: the maps of a result, and one file for each form they are written in."""
