"""Seconds of one edit, and what they cover."""

from collections.abc import Sequence
from dataclasses import dataclass

from edit3r.reporting import StageRecord

__all__ = ["Timing", "timing_of"]


@dataclass(frozen=True)
class Timing:
    """Wall and CPU seconds of one edit of one scene, by what they were spent on.

    Reading pictures, building components (loading weights), measuring and writing files are not in it. Cold: the first
    edit of its process, which also pays for imports, compilation and first touches; a warm one does not.
    """

    cold: bool
    editor: float  # the 2D editor on all views [s wall]
    network: float  # the reconstructor; with an editor inside it, that one's time too [s wall]
    rendering: float  # the measured pictures [s wall]
    editor_cpu: float
    network_cpu: float
    rendering_cpu: float

    @property
    def total_cpu(self) -> float:
        """Editor, network and rendering [s CPU]."""
        return self.editor_cpu + self.network_cpu + self.rendering_cpu


def timing_of(stages: Sequence[StageRecord], cold: bool) -> Timing:
    """From the stages of a run's report, told apart by how their names begin."""
    parts = {"editor": "edit (", "network": "reconstruct (", "rendering": "render"}
    wall, cpu = {}, {}
    for name, start in parts.items():
        own = [stage for stage in stages if stage.name.startswith(start)]
        wall[name] = sum(stage.seconds for stage in own)
        cpu[f"{name}_cpu"] = sum(stage.cpu_seconds for stage in own)
    return Timing(cold=cold, **wall, **cpu)
