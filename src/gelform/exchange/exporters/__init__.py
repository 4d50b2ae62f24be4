"""Files for other programs, and of simulated presses; folders appear complete or not at all."""

from gelform.exchange.exporters.press_folder import (
    SetOfPresses,
    save_press_folder,
    save_simulated_press,
    save_simulated_presses,
    save_simulated_set,
    written_whole,
)

__all__ = [
    "SetOfPresses",
    "save_press_folder",
    "save_simulated_press",
    "save_simulated_presses",
    "save_simulated_set",
    "written_whole",
]
