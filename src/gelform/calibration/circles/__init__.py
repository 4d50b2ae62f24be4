"""The contact circle of each press: found, refined, and the pixels whose slope is known by it."""
