"""The command line, a shell over the library: each command parses its options, calls the library and reports."""

from gelform.cli.app import app, command_names, main

__all__ = ["app", "command_names", "main"]
