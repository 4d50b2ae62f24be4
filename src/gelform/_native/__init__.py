"""The checked interface to the C kernels in native/: `Kernel` declares one, `Handle` owns C memory."""

from gelform._native.kernel import Handle, Kernel, is_finite
from gelform._native.loader import ISAS, instruction_set, library

__all__ = ["ISAS", "Handle", "Kernel", "instruction_set", "is_finite", "library"]
