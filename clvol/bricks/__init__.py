"""Bricks (sort-last): a volume that no device or machine holds as a whole, rendered part by part.

tree.py       convex parts of a volume, and the order in which a camera sees them
composite.py  partial pictures, put together in that order
render.py     partial pictures of a scene, and which scenes can have them

A part is a box of the volume and the voxels around it that samples in it need (ghost voxels). Rays and steps are those
of the whole volume; a segment of a ray, with its surfaces, belongs to the part that holds its front (cl/owned_box.h).
Depth is found in a second pass over those parts in which opacity may reach one half, given what is in front of them.
"""
