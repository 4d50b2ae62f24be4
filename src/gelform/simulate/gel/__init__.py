"""The surface of the gel under an indenter."""
