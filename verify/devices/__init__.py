"""What stands at the other end of a port: joint encoders and pan bases.

One module a driver. Bytes are parsed by pure functions apart from the port (`*_lines`, `*_packets`,
`field_map`), so that they can be tested without one. No driver here can move a robot.
"""

from verify.devices.protocols import DeviceState, EncoderReading, Encoders, Pan, PanReading

__all__ = ["DeviceState", "EncoderReading", "Encoders", "Pan", "PanReading"]
