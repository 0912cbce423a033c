"""What run.json says of a finished run."""

from typing import Any

from edit3r.contract.reporting import Report
from edit3r.running.components import Components
from edit3r.running.records import Inputs, Records
from edit3r.running.run_folder import FRAME, METRIC_FRAME, TURNED

OWN_FRAME = "that of the given scene; OpenCV axes in c2w; its own unit of length"
"""The frame of a given scene and its cameras."""


def run_facts(
    records: Records, components: Components, report: Report
) -> dict[str, Any]:
    """What run.json says of a finished run, in its order; `RunFolder.write_manifest` adds what it
    says of every run.
    """
    config, judged = components.config, records.judged
    parts = {
        "editor": components.editor,
        "matcher": components.asked_matcher,
        "reconstructor": components.reconstructor,
        "rasterizer": components.rasterizer,
    }
    built = {kind: one for kind, one in parts.items() if one is not None}
    settings = {kind: getattr(one, "settings", None) for kind, one in built.items()}
    used = [*(task.editor for task in components.tasks), *[*built.values()][1:]]
    weights = {k: v for k, v in report.notes.items() if k.startswith("weights.")}
    return {
        "prompt": config.prompt,
        "seed": config.seed,
        "device": config.device,
        "settings": {"run": config.model_dump(), **settings},
        "plugins": [record for one in used for record in _plugins(one)],
        "inputs": records.inputs.files,
        "masks": records.inputs.mask_files,  # file: sha256
        "weights": list(weights.values()),
        "verdict": judged.verdict,
        "edit_verdict": judged.edit_verdict,  # null: no edit
        "selection_verdict": records.selection.verdict,  # null: nothing was looked for
        "gaussians": records.gaussians.count,
        "harmonics_degree": records.gaussians.degree,
        "stages": report.stages,
        "warnings": report.warnings,
        **_frame(records.inputs),
        "notes": {k: v for k, v in report.notes.items() if k not in weights},
    }


def _frame(inputs: Inputs) -> dict[str, str]:
    """What run.json says of the frame, where it is not the usual one."""
    if inputs.scene is not None:
        return {"frame": OWN_FRAME}
    frame = FRAME if inputs.scale == 1 else METRIC_FRAME
    return {"frame": frame if inputs.up is None else f"{TURNED}{frame}"}


def _plugins(component: Any) -> list[dict[str, Any]]:
    """Who brought the component and the parts it was built with, as the registry remembers."""
    offer = getattr(component, "offer", None)
    if offer is None:  # an object the caller made by hand
        return []
    own = {
        "kind": offer.kind,
        "name": offer.component.name,
        "plugin": offer.plugin,
        "version": offer.version,
        "licence": offer.component.licence,
        "needs_network": offer.component.needs_network,
    }
    return [own, *(one for part in component.parts.values() for one in _plugins(part))]
