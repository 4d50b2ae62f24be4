"""The base of every room: checks of arguments, files of arrays, lent memory, processes, findings, progress."""
