"""Says at the end how many cases there were, and how they ended."""

from hostile.outcome import counts


def pytest_terminal_summary(terminalreporter):
    if counts:
        ended = ", ".join(f"{name} {count}" for name, count in sorted(counts.items()))
        terminalreporter.write_line(f"robustness: {sum(counts.values())} cases: {ended}")
