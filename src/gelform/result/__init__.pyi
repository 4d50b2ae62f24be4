from .record import KIND as KIND
from .record import Reconstruction as Reconstruction
from .record import load_result as load_result
from .record import save_result as save_result
from .shape import ShapeErrors as ShapeErrors
