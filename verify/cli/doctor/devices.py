"""Check a station's devices: each is opened and read for a second, all at once."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

import numpy as np

from verify.cli.doctor.machine import Finding
from verify.core.records import SIDES, Array
from verify.devices.melfa.reader import MelfaEncoders
from verify.devices.protocols import CameraDevice, Device, EncoderDevice, PanDevice
from verify.errors import InputError
from verify.live.station.station import Station

State = TypeVar("State")
START_TIMEOUT = 5.0  # s that a device is given for its first word
WATCH_TIME = 1.0  # s from then on


def check_devices(station: Station) -> list[Finding]:
    """Try all devices at once, as a run does: cameras share a bus."""
    found: list[Finding] = []
    trials: list[Callable[[], Finding]] = []
    try:
        for side, camera in zip(SIDES, station.open_cameras(), strict=True):
            trials.append(partial(_try_camera, f"{side} camera", camera, station))
    except InputError as error:
        found.append(Finding("cameras", "fails", str(error)))
    trials.append(partial(_try_encoders, station.open_encoders()))
    if (pan := station.open_pan()) is not None:
        trials.append(partial(_try_pan, pan))
    with ThreadPoolExecutor(len(trials)) as pool:
        found += pool.map(lambda trial: trial(), trials)
    if pan is None:
        found.append(Finding("pan bases", "works", "fixed, as the rig's calibration has them"))
    return found


def _try_camera(name: str, camera: CameraDevice, station: Station) -> Finding:
    frames, state = _watch(camera, lambda: [f] if (f := camera.read()) is not None else [])
    if not frames:
        return Finding(name, "fails", state.sentence)
    height, width = frames[0].image.shape[:2]
    t = np.array([frame.t for frame in frames])
    figures: dict[str, Any] = {"size": [width, height], "pictures": len(frames)}
    sentence = f"{state.sentence}; {width} x {height} px" + _rate(t, figures)
    if len(t) > 1:
        figures["longest_gap_ms"] = round(float(np.diff(t).max() * 1e3), 1)
        sentence += f", at most {figures['longest_gap_ms']:.0f} ms apart"
    if frames[0].raw is not None:
        sentence += ", JPEGs kept as they come"
    if (width, height) != tuple(station.rig.image_size):
        wanted = "{} x {}".format(*station.rig.image_size)
        return Finding(name, "fails", f"{sentence}; the rig is for {wanted} px", figures)
    missed = frames[-1].sequence - frames[0].sequence + 1 - len(frames)
    if missed:
        figures["missed"] = missed
        sentence += f"; {missed} were missed"
    return Finding(name, "doubt" if state.refused or missed else "works", sentence, figures)


def _try_encoders(encoders: EncoderDevice) -> Finding:
    readings, state = _watch(encoders, encoders.read)
    trips = list(encoders.round_trips) if isinstance(encoders, MelfaEncoders) else []
    if not readings:
        return Finding("encoders", "fails", state.sentence)
    t = np.array([reading.t_host for reading in readings])
    half = float(np.median([reading.half_width for reading in readings]))
    figures: dict[str, Any] = {"readings": len(t), "half_width_ms": round(half * 1e3, 4)}
    sentence = f"{state.sentence}; each known within ± {half * 1e3:.3g} ms" + _rate(t, figures)
    if trips:
        figures["round_trip_ms"] = round(float(np.median(trips)) * 1e3, 2)
        sentence += f", round trip {figures['round_trip_ms']:.1f} ms"
    angles = ", ".join(f"{angle:z.2f}°" for angle in np.rad2deg(readings[-1].q))
    outcome = "doubt" if state.bad or state.lost else "works"
    return Finding("encoders", outcome, f"{sentence}; now at {angles}", figures)


def _try_pan(pan: PanDevice) -> Finding:
    readings, state = _watch(pan, pan.read)
    if not readings:
        return Finding("pan bases", "fails", state.sentence)
    left, right = np.rad2deg(readings[-1].pan).tolist()
    sentence = f"{state.sentence}; left {left:z.2f}°, right {right:z.2f}°"
    return Finding("pan bases", "doubt" if state.bad else "works", sentence)


def _rate(t: Array, figures: dict[str, Any]) -> str:
    """Add the rate of readings at t (n,), s, to the figures, and describe it."""
    if len(t) < 2:
        return ""
    figures["rate_hz"] = round(float((len(t) - 1) / max(t[-1] - t[0], 1e-9)), 2)
    return f", {figures['rate_hz']:.1f} a second"


def _watch(device: Device[Any, State], read: Callable[[], list[Any]]) -> tuple[list[Any], State]:
    """Collect a device's readings for a second from the first one on, and its state; close it."""
    readings: list[Any] = []
    deadline = time.monotonic() + START_TIMEOUT
    while time.monotonic() < deadline:
        new = read()
        if new and not readings:
            deadline = time.monotonic() + WATCH_TIME
        readings += new
    state = device.state()
    device.close()
    return readings, state
