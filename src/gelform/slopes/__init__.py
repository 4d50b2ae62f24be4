"""From the image's colors to slopes, with the standard deviation and the confidence of each."""
