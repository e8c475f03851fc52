"""The lit scene of the other renderers: light, ground, and when the ground is visible."""

from __future__ import annotations

import math

# A white matte surface facing up has radiance 0.5 from the environment and 0.46 from the sun.
ENVIRONMENT_RADIANCE = 0.5
SUN_IRRADIANCE = 0.6 * math.pi
SUN_AZIMUTH_DEG = 40.0
SUN_ELEVATION_DEG = 50.0
GROUND_REFLECTANCE = 0.6  # linear
GROUND_RADII = 6.0  # radius of the ground disc, in radii of the object


def sun_direction() -> tuple[float, float, float]:
    """Return the unit vector from the object to the sun, +Z up."""
    azimuth, elevation = math.radians(SUN_AZIMUTH_DEG), math.radians(SUN_ELEVATION_DEG)
    return (
        math.cos(elevation) * math.cos(azimuth),
        math.cos(elevation) * math.sin(azimuth),
        math.sin(elevation),
    )


def sees_ground(camera_to_world: list[float], floor: float, radius: float) -> bool:
    """Return whether the camera is above the ground, which hides the object from below."""
    return camera_to_world[11] > floor + 0.02 * radius
