"""The end of a command on many frames: its findings by kind, and the exit status that they deserve."""

from __future__ import annotations

from gelform.cli.console import say
from gelform.cli.process import DOUBT, MISTAKE
from gelform.foundations.findings import DOUBTFUL, FrameTally


def status_of(tally: FrameTally, *, accept_doubtful: bool, quiet: bool) -> int:
    """Say the findings and errors of all frames; return the exit status."""
    by_count = sorted(tally.findings.items(), key=lambda one: (-one[1], one[0]))
    if by_count:
        shares = ", ".join(f"{name} {_percent(count, tally.frames)}" for name, count in by_count)
        say(f"Findings in {tally.frames} frames: {shares}.", quiet)
    if tally.failed:
        kind, count = max(tally.reasons.items(), key=lambda one: one[1])
        all_of = f"{tally.failed} of {tally.frames + tally.failed} frames failed"
        common = "Each" if count == tally.failed == 1 else f"The commonest reason ({count} frames)"
        say(f"gelform: error: {all_of}. {common}: {tally.examples[kind]}")
    if tally.frames and tally.is_useless:
        say(f"gelform: error: no frame was usable: depth is known in none of {tally.frames}.")
        return MISTAKE
    if not tally.is_doubtful:
        return MISTAKE if tally.failed else 0
    causes = ", ".join(f"{name} in {count}" for name, count in by_count if name in DOUBTFUL)
    say(
        f"gelform: error: the depth of {tally.doubtful} of {tally.frames} frames is doubtful ({causes or 'it is unknown'}). "
        "Are calibration and background of this sensor, with this gel and light? If they are: --accept-doubtful."
    )
    if tally.failed:
        return MISTAKE
    return 0 if accept_doubtful else DOUBT


def _percent(count: int, frames: int) -> str:
    share = 100 * count / frames
    return "under 1 %" if share < 1 else f"{share:.0f} %"
