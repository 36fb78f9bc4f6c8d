"""Image-space adaptivity: pictures cut into tiles with different numbers of rays (Ljung 2006, section 4).

geometry.py   positions of a tile's rays          work.py    lists of rays to cast
plan.py       how many rays each tile gets        refine.py  which tiles get more rays
launch.py, join.py, statistics.py                 the host side of the kernels
engine.py    what casts rays                      canvas.py  pictures on one device, or on several
picture.py, tiled.py                              pictures made of all of these
"""
