"""Measurements of clvol: beside a peer, of its inner loop, of how cost grows, of a whole process, and
of the order of accuracy.

``python -m bench`` runs all of them, ``--list`` names them, ``--quick`` is a small run that shows
that all works. Figures go to bench/results/ as JSON and charts; every figure was measured in the
run that states it, and the machine's load at that time is kept beside it.
"""
