"""Filters other than the linear one, and the prefilter of the B-spline."""

from __future__ import annotations

from clvol.features.effect import no, yes
from clvol.features.findings import Findings
from clvol.features.kernels import described, kernel_of
from clvol.features.vocabulary import FILTERS


def analyse(found: Findings) -> None:
    integration = found.scene.integration
    filter = integration.filter
    for name in FILTERS:
        if name != "linear":
            is_it = name == filter
            told = f"the filter is {filter!r}"
            if is_it and kernel_of(integration) is not None:
                told += f", {described(integration)}"
            found.note((yes if is_it else no)(f"{name} filter", told))
    if not integration.prefilter:
        found.note(no("prefilter", "prefilter is false"))
    elif filter == "cubic":
        found.note(yes("prefilter", "the cubic filter interpolates the voxels"))
    else:
        found.note(no("prefilter", f"the filter is {filter!r}"))
        found.change(integration=integration.model_copy(update={"prefilter": False}))
