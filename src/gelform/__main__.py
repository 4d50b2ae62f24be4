"""`python -m gelform` and `gelform` run the command line; a signal ends them with one line from the first import on."""

import os
import signal
from typing import NoReturn

ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


def _end(number: int, frame: object) -> NoReturn:
    os.write(2, b"gelform: interrupted.\n")
    os._exit(130)


def run() -> None:
    """Run the command line. While nothing is begun, and once all is done, a signal has nothing to clean up."""
    before = {one: signal.getsignal(one) for one in ENDING}
    heeded = [one for one in ENDING if before[one] not in (None, signal.SIG_IGN)]
    for one in heeded:
        signal.signal(one, _end)
    from gelform.cli import main

    for one in heeded:
        signal.signal(one, before[one])
    try:
        main()
    finally:
        for one in heeded:
            signal.signal(one, _end)


if __name__ == "__main__":
    run()
