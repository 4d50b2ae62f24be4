"""Where the object moved: its pose between contacts, along a recording, and one surface of several contacts."""
