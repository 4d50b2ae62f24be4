"""Files that other programs write or read, and pictures of results."""
