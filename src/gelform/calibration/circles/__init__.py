"""The contact circle of each press: found and refined; it gives the slopes of the pixels inside."""
