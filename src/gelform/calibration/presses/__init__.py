"""Reading of presses from folders, other packages' layouts and videos into a press set."""
