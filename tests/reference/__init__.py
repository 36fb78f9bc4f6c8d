"""The plain twin of every effect: the definition in numpy, float64, slow and obvious.

Only tests use it. It marches all rays of a small picture together, with the kernels' segments (from
each kept stretch's start, a step each, the last one shorter), so that at equal step both agree to
float32's and the tables' rounding. It shares nothing with the kernels but the definition.

What the definition's short form leaves open is this here:

A surface cuts a segment in proportion: its parts keep the segment's colour and lighting, and the
optical depth of their share of its length. The ray's grid of steps stays; a bend starts a new one.
Where there is no gradient a ray goes straight on, and that is no bend. Under the nearest filter the
gradient at a crossing is that of the voxel beyond it. A mask scales a segment's optical depth by the share of its
length that is kept, and removes surfaces outside it. The order: label, density, mask. A sample whose shadow ray is
not cast is not shadowed. A shadow ray has the factors, fields, clips and surfaces of the volume; its own
direction counts for the directional factor, it is post-classified and does not bend. Near a cut
face, s < 1 smallest edges behind it, the normal is (1 - s) clip's + s gradient's (turned to the
clip's side first if the material is two-sided), also where there is no gradient; fading looks at the
gradient alone. Noise is not in
gradients. Of an attenuated maximum, the integral before a value leaves out its own segment.
"""

from reference.march import render_twin

__all__ = ["render_twin"]
