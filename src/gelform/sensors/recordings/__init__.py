"""Frames of a camera kept as they came, and played again: MCAP files (extra `mcap`) and folders of images."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "facts": ["RecordingFacts", "RecordingSummary"],
        "image_folder": ["FolderRecording", "folder_summary", "recorded_folder_playback"],
        "mcap_reader": ["mcap_playback", "mcap_summary"],
        "mcap_writer": ["McapRecording"],
        "record": [
            "Recording",
            "RecordStats",
            "attached_background",
            "attached_calibration",
            "attachments_of",
            "new_recording",
            "record_frames",
        ],
    },
)
