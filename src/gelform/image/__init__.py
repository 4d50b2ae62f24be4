"""From a camera's frame to the image that the path works on, and what may be wrong with it."""
