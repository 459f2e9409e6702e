"""The rays of the compared presets, worked out here from their published definition, apart from presight."""

import numpy as np


def scanner(az_start, az_step, az_count, el_high, el_low, el_count):
    azimuth = np.radians(az_start + az_step * np.arange(az_count))
    elevation = np.radians(np.linspace(el_high, el_low, el_count))[:, None]
    flat = np.cos(elevation)
    up = np.broadcast_to(np.sin(elevation), (el_count, az_count))
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], axis=-1)


def camera(width, height, fx, fy, cx, cy):
    x = np.broadcast_to((np.arange(width) - cx) / fx, (height, width))
    y = np.broadcast_to(((np.arange(height) - cy) / fy)[:, None], (height, width))
    # Optical axes (z forward, x right, y down) to body axes (x forward, y left, z up).
    rays = np.stack([np.ones((height, width)), -x, -y], axis=-1)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def rosette():
    """Two prisms at 7,294 and -4,664 rpm: 24,000 rays in the order of time, 100,000 a second."""
    turn = 2 * np.pi * np.arange(24_000) / 100_000 / 60
    y, z = np.radians(9.6) * np.array([f(7294 * turn) + f(-4664 * turn) for f in (np.cos, np.sin)])
    off = np.hypot(y, z)
    return np.stack([np.cos(off), y * np.sinc(off / np.pi), z * np.sinc(off / np.pi)], axis=-1)


def offset_rows():
    """Rows that are turned against each other by +-1 and +-3 degrees."""
    azimuth = 360 * np.arange(1024) / 1024 - 180 + np.tile([3, 1, -1, -3], 32)[:, None]
    elevation = np.radians(22.5 - 45 * np.arange(128) / 127)[:, None]
    flat, azimuth = np.cos(elevation), np.radians(azimuth)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation) + 0 * azimuth], axis=-1)


# name: (unit rays in body axes with shape (rows, columns, 3), range_max in metres)
SENSORS = {
    "microwave-radar-image": lambda: (scanner(-180.0, 0.28125, 1280, 25.0, -25.0, 200), 75.0),
    "video-camera": lambda: (camera(512, 512, 9.0 / 8.8 * 512, 9.0 / 6.6 * 512, 255.5, 255.5), np.inf),
    "laser-range-camera": lambda: (scanner(-30.0, 60.0 / 320.0, 321, 5.0, -55.0, 41), 10.0),
    "microwave-radar-scan": lambda: (scanner(-180.0, 0.1, 3600, 0.0, 0.0, 1), 75.0),
    "3600 level": lambda: (scanner(-180.0, 0.1, 3600, 0.0, 0.0, 1), 75.0),
    "3600 leaning": lambda: (scanner(-180.0, 0.1, 3600, 0.0, 0.0, 1), 75.0),
    "laser-scanner": lambda: (scanner(-90.0, 0.5, 361, 0.0, 0.0, 1), 30.0),
    "laser-scanner leaning": lambda: (scanner(-90.0, 0.5, 361, 0.0, 0.0, 1), 30.0),
    "scanner 270": lambda: (scanner(-135.0, 0.25, 1081, 0.0, 0.0, 1), 30.0),
    "vlp-16": lambda: (scanner(-180.0, 0.2, 1800, 15.0, -15.0, 16), 100.0),
    "os1-128": lambda: (scanner(-180.0, 0.3515625, 1024, 22.5, -22.5, 128), 120.0),
    "rosette": lambda: (rosette(), 260.0),
    "offset rows": lambda: (offset_rows(), 120.0),
}


def rotation(roll_deg, pitch_deg, yaw_deg):
    """Rz(yaw) Ry(pitch) Rx(roll): world_from_sensor."""
    r, p, y = np.radians([roll_deg, pitch_deg, yaw_deg])
    rx = np.array([[1, 0, 0], [0, np.cos(r), -np.sin(r)], [0, np.sin(r), np.cos(r)]])
    ry = np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
    rz = np.array([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]])
    return rz @ ry @ rx
