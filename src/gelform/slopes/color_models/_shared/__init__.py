"""Common parts of color models: regression, small networks, tables, and the training zone of colors."""
