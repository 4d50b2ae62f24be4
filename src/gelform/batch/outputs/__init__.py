"""The output of a batch: the maps of a result, and one module for each form of files."""
