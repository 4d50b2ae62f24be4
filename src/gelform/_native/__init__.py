"""The checked interface to the C kernels in native/: `Kernel` declares one, `Handle` owns C memory."""

from gelform._native.kernel import ISAS, Handle, Kernel, instruction_set, is_finite, library

__all__ = ["ISAS", "Handle", "Kernel", "instruction_set", "is_finite", "library"]
