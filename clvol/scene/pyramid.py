"""[pyramid]: settings of the method of that name."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from clvol.scene.knob import Knob
from clvol.scene.table import Number, Table, Whole

MOST_LEVELS = 5  # MOST_LEVELS of cl/pyramid.h, which has arrays for so many
DEFAULT_ORACLE = "error"
_OURS = ("pyramid",)


def _oracles(*_: Any) -> tuple[str, ...]:
    from clvol.integrators.pyramid.oracles import names

    return names()


def _has_epsilon(scene: Any) -> bool:
    from clvol.integrators.pyramid.oracles import oracle_named

    return oracle_named(scene.pyramid.oracle).takes_epsilon


class Pyramid(Table):
    """``levels``: samples may be up to 2^levels steps apart, along rays and across them. ``oracle``: what says how
    far apart they may be (clvol/integrators/pyramid/oracles). ``epsilon``: what the oracle allows."""

    levels: Annotated[
        Whole, Knob("levels", "", (5, 4, 3, 2, 1, 0), methods=_OURS)
    ] = Field(
        3, ge=0, le=MOST_LEVELS,
        title="Samples may be up to 2^levels steps apart, along rays and across them.",
        description=f"a whole number from 0 to {MOST_LEVELS}",
    )
    oracle: Annotated[
        str, Knob("oracle", "", _oracles, is_ladder=False, alone=True, methods=_OURS)
    ] = Field(
        DEFAULT_ORACLE, min_length=1,
        title="What allows samples to be far apart: 'minimum', 'visible', 'opacity-gradient', 'bandwidth', 'error'.",
        description="the name of an oracle",
    )
    epsilon: Annotated[
        Number,
        Knob(
            "epsilon", "", (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4),
            methods=_OURS, applies=_has_epsilon,
        ),
    ] = Field(
        1e-2, gt=0, le=1,
        title="Error or change that the oracle allows; its unit depends on the oracle.",
        description="a number greater than 0, at most 1",
    )  # fmt: skip

    @classmethod
    def table_name(cls) -> str:
        return "pyramid"
