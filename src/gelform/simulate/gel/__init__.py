"""The surface of the gel under an indenter, and how it is dragged sideways."""
