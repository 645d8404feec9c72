"""A station of two simulated cameras that watch a board."""

SMALL = """
format = 1
seed = 5
[boards]
pairs = 12
distance_mm = [600.0, 1100.0]
[rig]
image_size = [640, 360]
[rig.left]
focal_px = [505.0, 505.0]
principal_point_px = [321.0, 178.0]
[rig.right]
focal_px = [507.0, 507.0]
principal_point_px = [318.0, 181.0]
"""


STATION = """
format = 1
[left]
source = "sim"
[right]
source = "sim"
[sim]
scenario = "small.toml"
"""
