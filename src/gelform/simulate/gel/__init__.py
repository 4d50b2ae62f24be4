"""The surface of the gel under an indenter, and its sideways drag."""
