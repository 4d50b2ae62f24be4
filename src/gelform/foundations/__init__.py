"""What every room stands on: checks at public doors, files of arrays, lent memory, processes, findings, progress."""
