"""Files for other programs, and of simulated presses; folders appear complete or not at all."""

from gelform.exporters.folders import written_whole
from gelform.exporters.press_folder import save_press_folder, save_simulated_presses
from gelform.exporters.simulated import SetOfPresses, save_simulated_press, save_simulated_set

__all__ = [
    "SetOfPresses",
    "save_press_folder",
    "save_simulated_press",
    "save_simulated_presses",
    "save_simulated_set",
    "written_whole",
]
