"""What a visitor takes along: files of a frame, and the code that gives the same."""
