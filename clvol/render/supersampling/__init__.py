"""More than one ray per pixel, above all methods: which pixels, where in them, and what a pixel becomes.

pattern.py   places of rays in a pixel              pixel_filter.py  how a pixel weighs them
edges.py     pixels that differ from a neighbour    thin.py          pixels that may hide something thin
picture.py   pictures made of all of these
"""
