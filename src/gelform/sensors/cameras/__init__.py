"""USB cameras: list them, choose one, set its controls, and read its frames."""
