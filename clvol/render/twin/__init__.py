"""The plain twin of every effect: the definition in numpy, float64, slow and obvious.

Only tests use it. It marches all rays of a small picture together, with the kernels' segments (from
each kept stretch's start, a step each, the last one shorter), so that at equal step both agree to
float32's and the tables' rounding. It shares nothing with the kernels but the definition.
"""

from clvol.render.twin.march import render_twin

__all__ = ["render_twin"]
