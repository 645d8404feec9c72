"""The kinds of arm that have a closed form; a new one is a module and a line here."""

from robots import parallel_axes, spherical_wrist
from robots.closed_form import Family

FAMILIES: dict[str, Family] = {
    "spherical_wrist": spherical_wrist,
    "parallel_axes": parallel_axes,
}
