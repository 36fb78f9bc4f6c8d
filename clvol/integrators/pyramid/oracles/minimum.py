"""The oracle that requires full resolution everywhere."""

from __future__ import annotations

from clvol.integrators.pyramid.oracle import KERNEL_MINIMUM, Oracle


class Minimum(Oracle):
    """Distance 0: every pixel on every slice is sampled, empty or not. It shows the cost of the method where
    it saves nothing (Kraus et al. 2007, tables 2 and 3, "min.")."""

    name = "minimum"
    kernel = KERNEL_MINIMUM
    takes_epsilon = False
    leaps = False
