"""Robots from MJCF and URDF files, as systems of the package, and motions back to MuJoCo."""
