"""What others made: their calibrations, data folders, meshes and height images."""
