"""Oracles: how far apart samples may be, anywhere in a scene's volume. One file each.

An oracle is asked on the device, with every sample, by the function ``oracle_distance`` of its kernel header (cl/oracle.h
has its signature). Most know the answer beforehand: they make a map of distances on the host or the device, once for a
volume and a transfer function, and share the header that looks it up (``KERNEL_MAP``).

To add one:

    from clvol.integrators.pyramid.oracles import MapOracle, register

    class Everywhere(MapOracle):
        name = "everywhere-alike"
        def distances(self, asked):                      # in smallest voxel edges, [z, y, x] of asked.shape
            return np.full(asked.shape, 4.0)

    register(Everywhere())                               # then [pyramid] oracle = "everywhere-alike"

or, with a function of its own in OpenCL C, ``Oracle`` with ``kernel = KERNEL_CUSTOM`` and ``folder`` that of a file
"oracle_custom.h"; one that does not look at the sample's value says ``#define ORACLE_NEEDS_VALUE 0``. Such code is the
caller's own: no scene or data file can bring any.
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
    """Makes ``oracle`` known by its name, instead of one of the same name."""
    _known[oracle.name] = oracle


def names() -> tuple[str, ...]:
    """The names that [pyramid] oracle may have: from the one that samples most."""
    return tuple(_known)


def oracle_named(name: str) -> Oracle:
    """KeyError for an unknown one."""
    return _known[name]


for _kind in (Minimum, Visible, OpacityGradient, Bandwidth, Error):
    register(_kind())
