"""The surroundings: textured ground, things on it, lamps that light it; as views and as images."""

from __future__ import annotations


def warm() -> None:
    """Compile the kernels, or load them from the cache; numba is imported here and not before."""
    import numpy as np  # noqa: PLC0415

    from heliograph_services.event_source.cameras import changes  # noqa: PLC0415
    from heliograph_services.event_source.simulation.ground import light, texture, warp  # noqa: PLC0415

    texels, bases = texture.Texture((np.ones((4, 4), np.float32),), 1.0).packed(1.0, 0.1)
    texture.warm()
    half, full = np.zeros((2, 2), np.float32), np.zeros((4, 4), np.float32)
    warp.render_ground(texels, bases, 2, 1.0, np.eye(3), 1.0, 0.0, 0.0, full)
    lines = np.zeros((4, 3))
    warp.draw_quad(lines, 0.0, full)
    warp.cover_quad(lines, full)
    warp.double(half, full)
    groups = np.zeros((1, 4, 4), np.float32)
    warp.lit(full, full, groups, groups, 0.0, np.zeros(1, np.float32), np.zeros(4, np.int64), full.copy())
    changes.warm()
    nodes, one, none = np.zeros((1, 2)), np.zeros(1), np.zeros(0)
    image = np.zeros((1, 1))
    light.add_lights(
        0.0, 1.0, nodes, nodes, nodes, nodes, one, np.zeros(2, np.int64), none, none, 0.0, 0.0, 0.0,
        image, image.copy(), np.zeros((1, 1), np.int16),
    )  # fmt: skip
