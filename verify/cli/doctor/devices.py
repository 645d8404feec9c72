"""Check a station's devices: each is opened and read for a second, all at once."""

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from verify.cli.doctor.machine import Finding
from verify.devices.melfa.reader import MelfaEncoders
from verify.devices.protocols import CameraDevice, EncoderDevice, EncoderReading, PanDevice
from verify.errors import InputError
from verify.live.station.station import Station

START_TIMEOUT = 5.0  # s that a device is given for its first word
WATCH_TIME = 1.0  # s from then on
MIN_RATE_RATIO = 0.9  # share of the rate asked for below which it is doubtful


def check_devices(station: Station) -> list[Finding]:
    """Try all devices at once, as a run does: cameras share a bus."""
    found: dict[str, Finding] = {}
    cameras: tuple[CameraDevice, CameraDevice] | None = None
    works: list[tuple[str, Callable[[], Finding]]] = []
    try:
        cameras = station.open_cameras()
    except InputError as error:
        found["cameras"] = Finding("cameras", "fails", str(error))
    for side, camera in zip(("left camera", "right camera"), cameras or (), strict=False):
        works.append((side, _try_camera(side, camera, station)))
    encoders, pan = station.open_encoders(), station.open_pan()
    works.append(("encoders", _try_encoders(encoders)))
    if pan is not None:
        works.append(("pan bases", _try_pan(pan)))

    def run(name: str, work: Callable[[], Finding]) -> None:
        found[name] = work()

    threads = [threading.Thread(target=run, args=work, daemon=True) for work in works]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if pan is None:
        said = "fixed, as the rig's calibration has them"
        found["pan bases"] = Finding("pan bases", "works", said)
    order = ("cameras", "left camera", "right camera", "encoders", "pan bases")
    return [found[name] for name in order if name in found]


def _try_camera(name: str, camera: CameraDevice, station: Station) -> Callable[[], Finding]:
    def work() -> Finding:
        frames = _collect_readings(lambda: [f] if (f := camera.read()) is not None else [])
        state = camera.state()
        camera.close()
        if not frames:
            return Finding(name, "fails", state.sentence)
        height, width = frames[0].image.shape[:2]
        t = np.array([frame.t for frame in frames])
        figures: dict[str, Any] = {"size": [width, height], "pictures": len(frames)}
        sentence = f"{state.sentence}; {width} x {height} px"
        if len(t) > 1:
            figures["rate_hz"] = round(float((len(t) - 1) / max(t[-1] - t[0], 1e-9)), 2)
            figures["longest_gap_ms"] = round(float(np.diff(t).max() * 1e3), 1)
            sentence += f", {figures['rate_hz']:.1f} a second"
            sentence += f", at most {figures['longest_gap_ms']:.0f} ms apart"
        if frames[0].raw is not None:
            sentence += ", JPEGs kept as they come"
        if (width, height) != tuple(station.rig.image_size):
            wanted = "{} x {}".format(*station.rig.image_size)
            return Finding(name, "fails", f"{sentence}; the rig is for {wanted} px", figures)
        missed = frames[-1].sequence - frames[0].sequence + 1 - len(frames)
        if missed:
            figures["missed"] = missed
            sentence += f"; {missed} were missed meanwhile"
        doubtful = bool(state.refused or missed)
        return Finding(name, "doubt" if doubtful else "works", sentence, figures)

    return work


def _try_encoders(encoders: EncoderDevice) -> Callable[[], Finding]:
    def work() -> Finding:
        readings: list[EncoderReading] = _collect_readings(encoders.read)
        state = encoders.state()
        trips = list(encoders.round_trips) if isinstance(encoders, MelfaEncoders) else []
        encoders.close()
        if not readings:
            return Finding("encoders", "fails", state.sentence)
        t = np.array([reading.t_host for reading in readings])
        half = float(np.median([reading.half_width for reading in readings]))
        figures: dict[str, Any] = {"readings": len(t), "half_width_ms": round(half * 1e3, 4)}
        sentence = f"{state.sentence}; each known within ± {half * 1e3:.3g} ms"
        if len(t) > 1:
            figures["rate_hz"] = round(float((len(t) - 1) / max(t[-1] - t[0], 1e-9)), 2)
            sentence += f", {figures['rate_hz']:.1f} a second"
        if trips:
            figures["round_trip_ms"] = round(float(np.median(trips)) * 1e3, 2)
            sentence += f", round trip {figures['round_trip_ms']:.1f} ms"
        angles = ", ".join(f"{angle:.2f}°" for angle in np.rad2deg(readings[-1].q))
        doubtful = bool(state.bad or state.lost)
        sentence += f"; now at {angles}"
        return Finding("encoders", "doubt" if doubtful else "works", sentence, figures)

    return work


def _try_pan(pan: PanDevice) -> Callable[[], Finding]:
    def work() -> Finding:
        readings = _collect_readings(pan.read)
        state = pan.state()
        pan.close()
        if not readings:
            return Finding("pan bases", "fails", state.sentence)
        left, right = np.rad2deg(readings[-1].pan).tolist()
        sentence = f"{state.sentence}; left {left:.2f}°, right {right:.2f}°"
        return Finding("pan bases", "doubt" if state.bad else "works", sentence)

    return work


def _collect_readings(read: Callable[[], list[Any]]) -> list[Any]:
    """Collect what a device gives for a second from its first word on; empty if it is mute."""
    things: list[Any] = []
    deadline = time.monotonic() + START_TIMEOUT
    while time.monotonic() < deadline:
        new = read()
        if new and not things:
            deadline = time.monotonic() + WATCH_TIME
        things += new
    return things
