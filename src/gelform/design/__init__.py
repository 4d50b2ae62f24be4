"""LED layouts compared before they are built."""

from gelform.design.picture import design_picture
from gelform.design.study import VARIATIONS, DesignResult, Variation, compare_designs, light_quality

__all__ = [
    "DesignResult",
    "VARIATIONS",
    "Variation",
    "compare_designs",
    "design_picture",
    "light_quality",
]
