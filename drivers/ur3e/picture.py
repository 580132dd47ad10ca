"""Pictures of the simulated cell, drawn without a screen through EGL. Loaded only where a picture is asked for."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from mujoco.egl import GLContext
from PIL import Image

from drivers.ur3e.scene import Scene
from runtime.errors import InputError

_GEOMS = 5000  # more than any board needs


def write_picture(scene: Scene, path: Path, camera: str, width: int, height: int) -> None:
    """Write a PNG of the scene as it is now, seen by the camera `iso` or `board`."""
    if camera not in ("iso", "board"):
        raise InputError(f"no camera {camera!r}; known: iso, board")
    context = GLContext(width, height)
    context.make_current()
    try:
        pixels = np.empty((height, width, 3), dtype=np.uint8)
        area = mujoco.MjrRect(0, 0, width, height)
        renderer = mujoco.MjrContext(scene.model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, renderer)
        eye = mujoco.MjvCamera()
        eye.type, eye.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, scene.model.camera(camera).id
        look = mujoco.MjvScene(scene.model, maxgeom=_GEOMS)
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(scene.model, scene.data, mujoco.MjvOption(), None, eye, everything, look)
        mujoco.mjr_render(area, look, renderer)
        mujoco.mjr_readPixels(pixels, None, area, renderer)
        renderer.free()
    finally:
        context.free()
    Image.fromarray(pixels[::-1]).save(path)
