from .file import KIND as KIND
from .file import load_result as load_result
from .file import save_result as save_result
from .record import Later as Later
from .record import Reconstruction as Reconstruction
