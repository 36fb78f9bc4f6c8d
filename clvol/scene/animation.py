"""[animation]: what changes from one picture to the next."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from clvol.scene.keyframe import Keyframe, check_keyframes
from clvol.scene.table import AsTuple, Number, Table, Whole


class Animation(Table):
    """Time, number of frames, and what moves.

    ``time`` is the time of the first frame in seconds. ``cycle`` is the speed at which the transfer function's colours
    move through the values, in value ranges per second; they wrap around, and opacities stay. ``orbit_degrees`` is the
    angle by which the camera turns about its target over all frames. ``keyframe``: cameras and values of the scene at
    times between which they are interpolated; the turn is added to them.
    """

    time: Number = Field(
        0.0, ge=-1e6, le=1e6,
        title="Time of the first frame, in seconds.",
        description="seconds from -1e6 to 1e6",
    )
    frames: Whole = Field(
        1, ge=1, le=100000,
        title="Number of frames; above 1 the output is a video or a numbered series of pictures.",
        description="a whole number from 1 to 100000",
    )
    fps: Number = Field(
        25.0, gt=0, le=1000,
        title="Frames per second.",
        description="a number greater than 0, at most 1000",
    )
    cycle: Number = Field(
        0.0, ge=-1e6, le=1e6,
        title="Speed at which colours move through the values, in value ranges per second; opacities stay.",
        description="a number from -1e6 to 1e6",
    )
    orbit_degrees: Number = Field(
        0.0, ge=-36000, le=36000,
        title="Turn of the camera about its target over all frames, in degrees.",
        description="an angle from -36000 to 36000 degrees",
    )

    keyframe: Annotated[tuple[Keyframe, ...], AsTuple] = Field(
        (),
        title="The camera, and values of the scene, at times between which they are interpolated.",
        description="a list of tables with the keys time, camera and set, times ascending",
        examples=[[
            {"time": 0.0, "camera": {"position": [0.0, 0.0, 500.0]}},
            {"time": 2.0, "set": {"noise.0.amplitude": 20.0}},
        ]],
    )

    @model_validator(mode="after")
    def _keyframes_go_together(self) -> Animation:
        check_keyframes(self.keyframe)
        return self

    @classmethod
    def table_name(cls) -> str:
        return "animation"
