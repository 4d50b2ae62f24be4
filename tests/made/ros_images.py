"""Uncompressed pictures as messages of ROS 2, and MCAP files of them, written out by hand."""

import struct

import numpy as np


def raw_message(pixels, encoding="rgb8", *, wall_time_ns=7, padding=0, frame_id="cam"):
    """sensor_msgs/Image in CDR of (H, W, 3) uint8; `padding` bytes at the end of each row."""
    height, width = pixels.shape[:2]
    rows = np.pad(pixels.reshape(height, -1), ((0, 0), (0, padding)))
    body = bytearray(struct.pack("<iI", *divmod(wall_time_ns, 10**9)))
    body += _text(frame_id, len(body))
    body += bytes(-len(body) % 4) + struct.pack("<II", height, width)
    body += _text(encoding, len(body)) + b"\0"
    body += bytes(-len(body) % 4) + struct.pack("<II", rows.shape[1], rows.size) + rows.tobytes()
    return b"\0\1\0\0" + bytes(body)


def _text(text, at):
    code = text.encode() + b"\0"
    return bytes(-at % 4) + struct.pack("<I", len(code)) + code


def image_file(path, topics, *, schema="sensor_msgs/msg/Image", before=0):
    """An MCAP file with one message on each topic, of {topic: message}; `before`: messages of joints that come first."""
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as file:
        made = Writer(file, compression=CompressionType.NONE)
        made.start(profile="ros2")
        joints = made.register_schema("sensor_msgs/msg/JointState", "ros2msg", b"")
        pictures = made.register_schema(schema, "ros2msg", b"")
        other = made.register_channel("/joints", "cdr", joints)
        channels = {topic: made.register_channel(topic, "cdr", pictures) for topic in topics}
        for k in range(before):
            made.add_message(other, k, b"\0\1\0\0", k)
        for topic, messages in topics.items():
            for k, message in enumerate([messages] if isinstance(messages, bytes) else messages):
                made.add_message(channels[topic], 10**9 + k * 10**7, message, 0, 0)  # as rosbag2: no sequence
        made.finish()
    return path
