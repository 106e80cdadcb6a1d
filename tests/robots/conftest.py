"""MuJoCo renders without a screen where EGL is installed; it reads this as it is imported."""

import ctypes.util
import os

if ctypes.util.find_library("EGL"):
    os.environ.setdefault("MUJOCO_GL", "egl")
