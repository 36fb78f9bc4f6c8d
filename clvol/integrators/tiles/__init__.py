"""Image-space adaptivity: pictures cut into tiles with different numbers of rays (Ljung 2006, section 4).

geometry.py  where a tile's rays are          work.py    which rays are to be cast
plan.py      how many rays each tile gets      refine.py  which tiles get more
launch.py, join.py, statistics.py             the kernels' host side
picture.py, tiled.py                          pictures from all of it
plain.py     with the plain ray caster        twin.py    the kernels in numpy
"""
