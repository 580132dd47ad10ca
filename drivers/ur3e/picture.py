"""Pictures of the simulated cell, drawn without a screen through EGL. Loaded only where a picture is asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco.egl import GLContext
from PIL import Image

from drivers.ur3e.parameters import GRIPPER
from drivers.ur3e.scene import Scene, scene_xml
from runtime.errors import InputError

_GEOMS = 5000  # more than any board needs


def write_picture(scene: Scene, path: Path, camera: str, width: int, height: int) -> None:
    """Write a PNG of the scene as it is now, seen by the camera `iso` or `board`."""
    if camera not in ("iso", "board"):
        raise InputError(f"no camera {camera!r}; known: iso, board")
    model, data = _dressed(scene)
    context = GLContext(width, height)
    context.make_current()
    try:
        pixels = np.empty((height, width, 3), dtype=np.uint8)
        area = mujoco.MjrRect(0, 0, width, height)
        renderer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, renderer)
        eye = mujoco.MjvCamera()
        eye.type, eye.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera(camera).id
        look = mujoco.MjvScene(model, maxgeom=_GEOMS)
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, eye, everything, look)
        mujoco.mjr_render(area, look, renderer)
        mujoco.mjr_readPixels(pixels, None, area, renderer)
        renderer.free()
    finally:
        context.free()
    Image.fromarray(pixels[::-1]).save(path)


def _dressed(scene: Scene) -> tuple[Any, Any]:
    """The scene with everything that is only to be seen, in the same state."""
    xml = scene_xml(scene.board, scene.component, scene.workcell, scene.fidelity, visual=True)
    model: Any = mujoco.MjModel.from_xml_string(xml)
    for name in ("holes", "part"):
        model.body_pos[model.body(name).id] = scene.model.body(name).pos
        model.body_quat[model.body(name).id] = scene.model.body(name).quat
    for index, (position, quaternion) in enumerate(scene.standing[-len(scene.board.holes) :]):
        body = model.body(f"standing{index}").id
        model.body_pos[body], model.body_quat[body] = position, quaternion
    for name, present in (("waiting", scene.part_waiting), ("part", scene.holding)):
        body = model.body(name)
        for geom in range(int(body.geomadr[0]), int(body.geomadr[0]) + int(body.geomnum[0])):
            model.geom_rgba[geom, 3] *= float(present)
    gap = scene.component.body.size[1] / 2 + (0.0 if scene.holding else GRIPPER.stroke)
    for index, side in enumerate((-1, 1)):
        finger = model.geom(f"finger{index}").id
        model.geom_pos[finger, 1] = side * (gap + model.geom_size[finger, 1])
    data: Any = mujoco.MjData(model)
    data.qpos[:] = scene.data.qpos
    mujoco.mj_forward(model, data)
    return model, data
