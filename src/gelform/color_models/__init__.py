"""colour -> gradients: one model per file, listed in COLOR_MODELS."""
