"""What `edit3r tradeoff` measures: a plan file names points, each a choice of run settings."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import Field

from edit3r.contract.errors import SettingsError, suggest
from edit3r.contract.settings import Settings, make_settings, merge, of_file
from edit3r.kit.files.configs import read_yaml

SHIPPED = Path(__file__).with_name("tradeoff_plan.yaml")


class TradeoffPlan(Settings):
    """A plan file."""

    base: dict[str, Any]
    """run settings of every point"""
    points: dict[str, dict[str, Any]]
    """label of each point to the run settings that it lays over the base"""
    data: tuple[str, ...]
    """folders and data sets that are measured unless others are named"""
    size: int = Field(512, ge=32, le=4096)
    """side of the largest photos [pixels]"""
    datasets: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """settings of data sets by name"""

    def settings_of(self, labels: Sequence[str] | None = None) -> dict[str, dict]:
        """Return the run settings of each point by label; `labels`: of these points only."""
        settings = {}
        for label in labels or self.points:
            if label not in self.points:
                raise SettingsError(
                    f"--only {label}: no such point.{suggest(label, self.points)} "
                    f"Points: {', '.join(self.points)}."
                )
            settings[label] = merge(self.base, self.points[label])
        return settings


def read_plan(file: str = "", trusted: bool = False) -> TradeoffPlan:
    """Read a plan file, "" for the one that ships.

    Raises SettingsError naming the key that is wrong. A file that is not `trusted` gives no
    setting that names a program or an address.
    """
    path = file or SHIPPED
    content = read_yaml(path)
    return make_settings(
        TradeoffPlan, content if trusted else of_file(content), where=str(path)
    )
