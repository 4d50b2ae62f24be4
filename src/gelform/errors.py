"""What gelform raises beside ValueError and TypeError."""


class GelformError(Exception):
    """Base of every error that is gelform's own; the command line shows it as one line."""


class CalibrationError(GelformError):
    """A calibration cannot be made, read, or used on this image."""


class SensorError(GelformError):
    """A camera or a sensor profile does not answer as expected."""


class SourceLostError(SensorError):
    """A source of frames went away, stands still or sends what is no frame; opened again it may go on."""


class ConvergenceError(GelformError):
    """A solver did not reach its tolerance; the message names the cause and a remedy."""


class StaleError(SensorError):
    """A stream has no result that is new enough."""


class DataError(GelformError):
    """A file or folder is missing, unreadable, incomplete, altered or already there."""
