"""Oracles: how far apart samples may be, anywhere in a scene's volume. One file each.

The device evaluates an oracle at every sample, by the function ``oracle_distance`` of its kernel header (cl/oracle.h
has its signature). Most oracles compute a map of distances beforehand, on the host or the device, once per
volume and transfer function, and share the header that looks it up (``KERNEL_MAP``).

To add one:

    from clvol.integrators.pyramid.oracles import MapOracle, register

    class Everywhere(MapOracle):
        name = "everywhere-alike"
        def distances(self, asked):                      # in smallest voxel edges, [z, y, x] of asked.shape
            return np.full(asked.shape, 4.0)

    register(Everywhere())                               # then [pyramid] oracle = "everywhere-alike"

or, with a function in OpenCL C, an ``Oracle`` with ``kernel = KERNEL_CUSTOM`` and the ``folder`` of a file
"oracle_custom.h", which defines ``ORACLE_NEEDS_VALUE`` as 0 if it does not use the sample's value. Such code comes from
the caller: no scene or data file can supply any.
"""

from __future__ import annotations

from clvol.integrators.pyramid.oracle import (
    KERNEL_CUSTOM,
    KERNEL_ERROR,
    KERNEL_MAP,
    KERNEL_MINIMUM,
    Asked,
    MapOracle,
    Oracle,
)
from clvol.integrators.pyramid.oracles.bandwidth import Bandwidth
from clvol.integrators.pyramid.oracles.error import Error
from clvol.integrators.pyramid.oracles.minimum import Minimum
from clvol.integrators.pyramid.oracles.opacity_gradient import OpacityGradient
from clvol.integrators.pyramid.oracles.visible import Visible

_known: dict[str, Oracle] = {}

__all__ = [
    "KERNEL_CUSTOM",
    "KERNEL_ERROR",
    "KERNEL_MAP",
    "KERNEL_MINIMUM",
    "Asked",
    "MapOracle",
    "Oracle",
    "names",
    "oracle_named",
    "register",
]


def register(oracle: Oracle) -> None:
    """Registers ``oracle`` under its name, replacing one of the same name."""
    _known[oracle.name] = oracle


def names() -> tuple[str, ...]:
    """The names that [pyramid] oracle may have, starting with the one that samples most."""
    return tuple(_known)


def oracle_named(name: str) -> Oracle:
    """The oracle of this name; KeyError for an unknown one."""
    return _known[name]


for _kind in (Minimum, Visible, OpacityGradient, Bandwidth, Error):
    register(_kind())
