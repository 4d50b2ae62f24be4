"""The report of a calibration run: numbers, words and a page; submodules are imported on first use."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "content": ["report_content"],
        "page": ["report_page"],
        "record": ["CalibrationReport", "PressReport", "learning_curve", "summary"],
    },
)
